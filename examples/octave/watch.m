% Shows position, speed and current of every axis on a link, without moving any:
% octave watch.m "tmcl+serial:///dev/ttyUSB0:9600#1,3" 10
given = argv();
defaults = {"sim:tmcl:1,3?time=virtual", "5"};
given = [given(:)', defaults(numel(given) + 1:end)];

link = polepair("open", given{1});
for place = 1:polepair("axis_count", link)
  axis = polepair("axis", link, place);
  info = polepair("info", axis);
  printf("%s (%s)\n", info.label, info.title);
  % Only what this drive can tell.
  signals = {"position", "velocity", "current"};
  signals = signals(cellfun(@(signal) polepair("has_signal", axis, signal), signals));
  trace = polepair("trace", axis, signals, 0.1);
  for n = 1:str2double(given{2})
    row = polepair("trace_read", trace, 10);
    for column = 1:numel(signals)
      printf("  %s %.4f", signals{column}, row(column + 1));
    end
    printf("\n");
  end
  polepair("close", trace);
  polepair("close", axis);
end
polepair("close", link);
