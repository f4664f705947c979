% Finds the drives on a link, by reads only: octave find.m tmcl+serial:///dev/ttyUSB0:9600 32
given = argv();
defaults = {"sim:tmcl:1,3?time=virtual", "8"};
given = [given(:)', defaults(numel(given) + 1:end)];

found = polepair("scan", given{1}, 1, str2double(given{2}));
for drive = found'
  printf("%d: %s, %s\n", drive.number, drive.title, drive.identity);
  if !isempty(drive.clash)
    printf("   %s\n", drive.clash);
  end
end
if isempty(found)
  disp("nobody answered");
end
