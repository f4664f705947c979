{ Finds the drives on a link, by reads only: find tmcl+serial:///dev/ttyUSB0:9600 32 }
program Find;

{$ifdef FPC}{$mode delphi}{$endif}

uses
  SysUtils, Polepair;

var
  Url: AnsiString;
  Found: TPolepairFoundArray;
  I: Integer;
begin
  Url := 'sim:tmcl:1,3?time=virtual';
  if ParamCount > 0 then
    Url := AnsiString(ParamStr(1));
  Found := PolepairScan(Url, 1, StrToIntDef(ParamStr(2), 8));
  for I := 0 to High(Found) do
  begin
    WriteLn(Found[I].Number, ': ', PAnsiChar(@Found[I].Title), ', ', PAnsiChar(@Found[I].Identity));
    if Found[I].Clash[0] <> #0 then
      WriteLn('   ', PAnsiChar(@Found[I].Clash));
  end;
  if Length(Found) = 0 then
    WriteLn('nobody answered');
end.
