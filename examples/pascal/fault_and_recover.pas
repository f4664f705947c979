{ Meets a fault, says what it means, takes the cause away, clears it and goes on:
  fault_and_recover "tmcl+serial:///dev/ttyUSB0:9600#1"
  On a simulated drive it lets the supply sag; on a real one it reports what happens by itself. }
program FaultAndRecover;

{$ifdef FPC}{$mode delphi}{$endif}

uses
  SysUtils, Polepair;

var
  Url: AnsiString;
  Link: TPolepairLink;
  Axis: TPolepairAxis;
  Simulated: Boolean;
begin
  Url := 'sim:tmcl?time=virtual';
  if ParamCount > 0 then
    Url := AnsiString(ParamStr(1));
  Link := TPolepairLink.Create(Url);
  Axis := Link.AxisAt(0);
  try
    Simulated := Axis.Info.IsSimulated <> 0;
    Axis.Arm;
    try
      Axis.Enable;
      Axis.Velocity('300 rpm');
      Link.Sleep(0.5);
      WriteLn('turning');

      if Simulated then
        Link.Act(0, 'supply=8');
      Link.Sleep(0.5);
      WriteLn('fault code ', Axis.Read(psFault):0:0);
      try
        Axis.Enable;
        WriteLn('no fault');
      except
        on Error: EPolepair do
        begin
          if Error.Status <> PP_DRIVE_FAULT then
            raise;
          WriteLn(Error.Message);
          WriteLn('what to do: ', Error.Hint);
        end;
      end;

      if Simulated then
        Link.Act(0, 'supply=24'); // the cause goes first
      Link.Sleep(0.5);
      Axis.Clear;
      Axis.Enable;
      Axis.Velocity('300 rpm');
      Link.Sleep(0.5);
      WriteLn('turning again at ', Axis.Read(psVelocity):0:1, ' rad/s');
    finally
      Axis.Release;
    end;
  finally
    Axis.Free;
    Link.Free;
  end;
end.
