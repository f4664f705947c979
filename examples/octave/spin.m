% Turns a motor for a while: octave spin.m "tmcl+serial:///dev/ttyUSB0:9600#1" "60 rpm" 3
% It is stopped and switched off however this ends.
given = argv();
defaults = {"sim:tmcl?time=virtual", "60 rpm", "2"};
given = [given(:)', defaults(numel(given) + 1:end)];

link = polepair("open", given{1});
unwind_protect
  axis = polepair("axis", link, 1);
  info = polepair("info", axis);
  printf("%s: %s\n", info.title, info.caution);
  polepair("arm", axis);
  polepair("enable", axis);  % where it stands
  polepair("velocity", axis, given{2});
  for quarter = 1:4
    polepair("sleep", link, str2double(given{3}) / 4);
    printf("%.1f rpm\n", polepair("read", axis, "velocity") * 30 / pi);
  end
unwind_protect_cleanup
  polepair("close", link);  % stopped, switched off, disarmed
end_unwind_protect
