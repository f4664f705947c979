{ Reads and writes parameters by name, with units: parameters "tmcl+serial:///dev/ttyUSB0:9600#1" "max current"
  It writes back the value that it read: a drive keeps the settings it had. }
program Parameters;

{$ifdef FPC}{$mode delphi}{$endif}

uses
  SysUtils, Polepair;

var
  Url, Name: AnsiString;
  Link: TPolepairLink;
  Axis: TPolepairAxis;
  Info: TPolepairAxisInfo;
  Parameter: TPolepairParameter;
  I: NativeUInt;
begin
  Url := 'sim:tmcl?time=virtual';
  Name := 'max current';
  if ParamCount > 0 then
    Url := AnsiString(ParamStr(1));
  if ParamCount > 1 then
    Name := AnsiString(ParamStr(2));
  Link := TPolepairLink.Create(Url);
  Axis := Link.AxisAt(0);
  try
    Info := Axis.Info;
    WriteLn(PAnsiChar(@Info.LabelText), ' is a ', PAnsiChar(@Info.Title));
    WriteLn(Name, ' = ', Axis.GetText(Name), ' (on the wire ', Axis.GetRaw(Name), ')');
    I := 0;
    repeat
      Parameter := Axis.ParameterAt(I);
      Inc(I);
    until AnsiString(PAnsiChar(@Parameter.Name)) = Name;
    WriteLn(PAnsiChar(@Parameter.About), ' In the manual: ', PAnsiChar(@Parameter.Symbol));

    // In the parameter's own unit; text may carry another one: Axis.SetText(Name, '1200 mA').
    Axis.SetValue(Name, Axis.Get(Name));

    // Outside the limits nothing is sent.
    try
      Axis.SetRaw(Name, Parameter.RawMax + 1);
      WriteLn('the limit is not where the profile says');
    except
      on Error: EPolepair do
      begin
        if Error.Executed <> 0 then
          raise;
        WriteLn(Error.Code, ': ', Error.Message);
      end;
    end;
  finally
    Axis.Free;
    Link.Free;
  end;
end.
