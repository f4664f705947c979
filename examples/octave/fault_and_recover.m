% Meets a fault, says what it means, takes the cause away, clears it and goes on:
% octave fault_and_recover.m "tmcl+serial:///dev/ttyUSB0:9600#1"
% On a simulated drive it lets the supply sag; on a real one it reports what happens by itself.
given = argv();
defaults = {"sim:tmcl?time=virtual"};
given = [given(:)', defaults(numel(given) + 1:end)];

link = polepair("open", given{1});
unwind_protect
  axis = polepair("axis", link, 1);
  simulated = polepair("info", axis).simulated;
  polepair("arm", axis);
  polepair("enable", axis);
  polepair("velocity", axis, "300 rpm");
  polepair("sleep", link, 0.5);
  disp("turning");

  if simulated
    polepair("act", link, 1, "supply=8");
  end
  polepair("sleep", link, 0.5);
  printf("fault code %g\n", polepair("read", axis, "fault"));
  try
    polepair("enable", axis);
    disp("no fault");
  catch failure
    disp(failure.message);
  end

  if simulated
    polepair("act", link, 1, "supply=24");  % the cause goes first
  end
  polepair("sleep", link, 0.5);
  polepair("clear", axis);
  polepair("enable", axis);
  polepair("velocity", axis, "300 rpm");
  polepair("sleep", link, 0.5);
  printf("turning again at %.1f rad/s\n", polepair("read", axis, "velocity"));
unwind_protect_cleanup
  polepair("close", link);
end_unwind_protect
