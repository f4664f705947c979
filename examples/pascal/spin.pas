{ Turns a motor for a while: spin "tmcl+serial:///dev/ttyUSB0:9600#1" "60 rpm"
  It is stopped and switched off however this ends. }
program Spin;

{$ifdef FPC}{$mode delphi}{$endif}

uses
  SysUtils, Polepair;

var
  Url, Speed: AnsiString;
  Link: TPolepairLink;
  Axis: TPolepairAxis;
  Info: TPolepairAxisInfo;
  I: Integer;
begin
  Url := 'sim:tmcl?time=virtual';
  Speed := '60 rpm';
  if ParamCount > 0 then
    Url := AnsiString(ParamStr(1));
  if ParamCount > 1 then
    Speed := AnsiString(ParamStr(2));
  Link := TPolepairLink.Create(Url);
  Axis := Link.AxisAt(0);
  try
    Info := Axis.Info;
    WriteLn(PAnsiChar(@Info.Title), ': ', PAnsiChar(@Info.Caution));
    Axis.Arm;
    try
      Axis.Enable; // enabled where it stands
      Axis.Velocity(Speed);
      for I := 1 to 4 do
      begin
        Link.Sleep(0.5);
        WriteLn(Axis.Read(psVelocity) * 30 / Pi:0:1, ' rpm');
      end;
    finally
      Axis.Release; // stopped, switched off, disarmed
    end;
  finally
    Axis.Free;
    Link.Free;
  end;
end.
