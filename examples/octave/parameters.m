% Reads and writes parameters by name, with units:
% octave parameters.m "tmcl+serial:///dev/ttyUSB0:9600#1" "max current"
% It writes back the value that it read: a drive keeps the settings it had.
given = argv();
defaults = {"sim:tmcl?time=virtual", "max current"};
given = [given(:)', defaults(numel(given) + 1:end)];
name = given{2};

link = polepair("open", given{1});
axis = polepair("axis", link, 1);
info = polepair("info", axis);
printf("%s is a %s\n", info.label, info.title);
printf("%s = %s (on the wire %d)\n", name, polepair("get_text", axis, name), polepair("get_raw", axis, name));
parameters = polepair("parameters", axis);
parameter = parameters(strcmp({parameters.name}, name));
printf("%s In the manual: %s\n", parameter.about, parameter.symbol);

% In the parameter's own unit; text may carry another one: polepair("set", axis, name, "1200 mA").
polepair("set", axis, name, polepair("get", axis, name));

% Outside the limits nothing is sent.
try
  polepair("set_raw", axis, name, parameter.raw_max + 1);
  disp("the limit is not where the profile says");
catch failure
  printf("%s: %s\n", strrep(failure.identifier, "polepair:", ""), strrep(failure.message, "polepair: ", ""));
end
polepair("close", link);
