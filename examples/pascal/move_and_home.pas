{ Finds the reference position, then moves there and back:
  move_and_home modbus-rtu+serial:///dev/ttyUSB0:115200#1 }
program MoveAndHome;

{$ifdef FPC}{$mode delphi}{$endif}

uses
  SysUtils, Polepair;

const
  AtMost = 60.0;
  Targets: array[0..1] of AnsiString = ('90 deg', '0 deg');

var
  Url: AnsiString;
  Link: TPolepairLink;
  Axis: TPolepairAxis;
  I: Integer;
begin
  Url := 'sim:tmcl?time=virtual';
  if ParamCount > 0 then
    Url := AnsiString(ParamStr(1));
  Link := TPolepairLink.Create(Url);
  Axis := Link.AxisAt(0);
  try
    if Axis.Info.IsSimulated <> 0 then
      Link.Act(0, 'home=0.5turn'); // a switch, as a mechanic would fit one
    Axis.Arm;
    try
      Axis.Enable;
      try
        if Axis.Home(AtMost) then
          WriteLn('home found')
        else
          WriteLn('no home in time');
      except
        on Error: EPolepair do
        begin
          if Error.Status <> PP_USAGE then
            raise;
          WriteLn(Error.Message); // a drive that cannot home is moved from where it stands
        end;
      end;
      for I := 0 to High(Targets) do
      begin
        Axis.MoveTo(Targets[I]);
        Axis.Wait(AtMost);
        WriteLn('at ', Targets[I], ': ', Axis.Read(psPosition):0:4, ' rad');
      end;
      Axis.MoveBy('-45 deg'); // never sent twice
      Axis.Wait(AtMost);
      WriteLn('45 degrees back: ', Axis.Read(psPosition):0:4, ' rad');
    finally
      Axis.Release;
    end;
  finally
    Axis.Free;
    Link.Free;
  end;
end.
