{ Shows position, speed and current of every axis on a link, without moving any:
  watch "tmcl+serial:///dev/ttyUSB0:9600#1,3" 10 }
program Watch;

{$ifdef FPC}{$mode delphi}{$endif}

uses
  SysUtils, Polepair;

const
  Wanted: array[0..2] of TPolepairSignal = (psPosition, psVelocity, psCurrent);
  Names: array[0..2] of AnsiString = ('position', 'velocity', 'current');

var
  Url: AnsiString;
  Link: TPolepairLink;
  Axis: TPolepairAxis;
  Info: TPolepairAxisInfo;
  At, Row, I: Integer;
begin
  Url := 'sim:tmcl:1,3?time=virtual';
  if ParamCount > 0 then
    Url := AnsiString(ParamStr(1));
  Link := TPolepairLink.Create(Url);
  try
    for At := 0 to Integer(Link.AxisCount) - 1 do
    begin
      Axis := Link.AxisAt(At);
      try
        Info := Axis.Info;
        WriteLn(PAnsiChar(@Info.LabelText), ' (', PAnsiChar(@Info.Title), ')');
        for Row := 1 to StrToIntDef(ParamStr(2), 5) do
        begin
          for I := 0 to High(Wanted) do
            if Axis.HasSignal(Wanted[I]) then // only what this drive can tell
              Write('  ', Names[I], ' ', Axis.Read(Wanted[I]):0:4);
          WriteLn;
          Link.Sleep(0.1);
        end;
      finally
        Axis.Free;
      end;
    end;
  finally
    Link.Free;
  end;
end.
