% Finds the reference position, then moves there and back:
% octave move_and_home.m modbus-rtu+serial:///dev/ttyUSB0:115200#1
given = argv();
defaults = {"sim:tmcl?time=virtual"};
given = [given(:)', defaults(numel(given) + 1:end)];
at_most = 60;

link = polepair("open", given{1});
unwind_protect
  axis = polepair("axis", link, 1);
  if polepair("info", axis).simulated
    polepair("act", link, 1, "home=0.5turn");  % a switch, as a mechanic would fit one
  end
  polepair("arm", axis);
  polepair("enable", axis);
  if polepair("home", axis, at_most)
    disp("home found");
  else
    disp("no home in time");
  end
  for target = {"90 deg", "0 deg"}
    polepair("move_to", axis, target{1});
    polepair("wait", axis, at_most);
    printf("at %s: %.4f rad\n", target{1}, polepair("read", axis, "position"));
  end
  polepair("move_by", axis, "-45 deg");  % never sent twice
  polepair("wait", axis, at_most);
  printf("45 degrees back: %.4f rad\n", polepair("read", axis, "position"));
unwind_protect_cleanup
  polepair("close", link);
end_unwind_protect
