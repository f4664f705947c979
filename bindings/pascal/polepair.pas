{ libpolepair for Delphi and Free Pascal: handles that free themselves, errors as exceptions.

      Link := TPolepairLink.Create('sim:tmcl');
      Axis := Link.Axis('1');
      Axis.Arm;
      try
        Axis.Enable;
        Axis.Velocity('60 rpm');
        Link.Sleep(2.0);
      finally
        Axis.Release;    // stopped, disabled, disarmed
      end;

  polepair.h documents the rules of each function. }
unit Polepair;

{$ifdef FPC}{$mode delphi}{$endif}
{$A8}
{$H+}

interface

uses
  SysUtils;

const
{$ifdef MSWINDOWS}
  PolepairLibrary = 'polepair.dll';
{$else}
  PolepairLibrary = 'polepair';
{$endif}

  PP_OK = 0;
  PP_NEGATIVE = 1;
  PP_USAGE = 2;
  PP_ADAPTER = 3;
  PP_NO_REPLY = 4;
  PP_CORRUPT = 5;
  PP_REFUSED = 6;
  PP_PARTIAL = 7;
  PP_DRIVE_FAULT = 8;
  PP_UNCONFIRMED = 9;
  PP_PENDING = 64;
  PP_NOTHING = 65;
  PP_BUFFER = 66;
  PP_FORKED = 67;
  PP_DEFECT = 68;

type
  TPolepairVerb = (pvEnable, pvDisable, pvClear, pvVelocity, pvTorque, pvMoveTo, pvMoveBy, pvMoveOn,
    pvCurveTo, pvCurveBy, pvHome, pvStore);
  TPolepairSignal = (psPosition, psVelocity, psTorque, psCurrent, psVoltage, psTemperature,
    psTargetPosition, psTargetVelocity, psFault, psEnabled, psMoving, psReached, psMode, psTime);

  TPolepairErrorRecord = record
    Size: Cardinal;
    Status, Executed, MayTurn: Integer;
    Code: array[0..31] of AnsiChar;
    Text: array[0..1023] of AnsiChar;
    Hint: array[0..511] of AnsiChar;
  end;

  TPolepairAxisInfo = record
    Size, Number, Kind, IsSimulated: Cardinal;
    Name, LabelText: array[0..63] of AnsiChar;
    Protocol: array[0..31] of AnsiChar;
    Profile: array[0..63] of AnsiChar;
    Title: array[0..127] of AnsiChar;
    Caution: array[0..511] of AnsiChar;
    Watchdog: array[0..255] of AnsiChar;
  end;

  TPolepairParameter = record
    Size, Readable, Writable, Moves: Cardinal;
    RawMin, RawMax: Int64;
    Name: array[0..127] of AnsiChar;
    Symbol: array[0..63] of AnsiChar;
    UnitText: array[0..31] of AnsiChar;
    Kind: array[0..15] of AnsiChar;
    Persistence: array[0..31] of AnsiChar;
    About: array[0..511] of AnsiChar;
  end;

  TPolepairFound = record
    Size, Number: Cardinal;
    Profile: array[0..63] of AnsiChar;
    Title: array[0..127] of AnsiChar;
    Identity, Clash: array[0..255] of AnsiChar;
  end;
  TPolepairFoundArray = array of TPolepairFound;

  { What a failed call raises. }
  EPolepair = class(Exception)
  public
    Status: Integer;
    Code, Hint: string;
    { 1 if the drive executed the request, 0 if not, -1 if that is unknown. }
    Executed: Integer;
    { The motor may still turn, and only cutting its supply stops it. }
    MayTurn: Boolean;
    constructor CreateOf(const Error: TPolepairErrorRecord);
  end;

  { One axis: a motor. }
  TPolepairAxis = class
  private
    FHandle: Pointer;
    procedure Check(Status: Integer);
  public
    constructor Create(Handle: Pointer);
    destructor Destroy; override;
    function Info: TPolepairAxisInfo;
    function Get(const Name: AnsiString): Double;
    function GetRaw(const Name: AnsiString): Int64;
    function GetText(const Name: AnsiString): string;
    procedure SetValue(const Name: AnsiString; Value: Double);
    procedure SetText(const Name, Value: AnsiString; Store: Boolean = False);
    procedure SetRaw(const Name: AnsiString; Value: Int64; Store: Boolean = False);
    function ParameterCount: NativeUInt;
    function ParameterAt(Index: NativeUInt): TPolepairParameter;
    function HasSignal(Signal: TPolepairSignal): Boolean;
    function Read(Signal: TPolepairSignal): Double;
    procedure Arm;
    { Stops, disables and disarms. }
    procedure Release;
    procedure Stop;
    procedure Enable;
    procedure Disable;
    procedure Clear;
    { False if it has not ended within so many seconds. }
    function Home(Seconds: Double): Boolean;
    procedure Velocity(const Speed: AnsiString);
    procedure MoveTo(const Position: AnsiString);
    procedure MoveBy(const Distance: AnsiString);
    procedure Run(Verb: TPolepairVerb; Target: Double);
    procedure RunText(Verb: TPolepairVerb; const Target: AnsiString);
    { Waits until a move has reached its target. }
    procedure Wait(Seconds: Double);
    property Handle: Pointer read FHandle;
  end;

  { A link: a wire, a simulation, or the axes of a running server. }
  TPolepairLink = class
  private
    FHandle: Pointer;
    procedure Check(Status: Integer);
  public
    constructor Create(const Url: AnsiString);
    { Stops what is armed. An error is lost here: Close raises it. }
    destructor Destroy; override;
    procedure Close;
    function AxisCount: NativeUInt;
    function AxisAt(Index: NativeUInt): TPolepairAxis;
    function Axis(const Name: AnsiString): TPolepairAxis;
    procedure StopAll;
    { Waits on the link's clock. }
    procedure Sleep(Seconds: Double);
    { Does something to a simulated drive: 'supply=18'. }
    procedure Act(Drive: NativeUInt; const What: AnsiString);
    property Handle: Pointer read FHandle;
  end;

{ Scans a wire for drives, by reads only. }
function PolepairScan(const Url: AnsiString; First, Last: Cardinal): TPolepairFoundArray;

implementation

uses
  Math;

function pp_link_open(Url: PAnsiChar; Length: NativeUInt; out Link: Pointer): Integer; cdecl; external PolepairLibrary;
function pp_link_close(Link: Pointer; Error: Pointer): Integer; cdecl; external PolepairLibrary;
function pp_link_error(Link: Pointer; var Error: TPolepairErrorRecord): Integer; cdecl; external PolepairLibrary;
function pp_link_axis_count(Link: Pointer; out Count: NativeUInt): Integer; cdecl; external PolepairLibrary;
function pp_link_axis_at(Link: Pointer; Index: NativeUInt; out Axis: Pointer): Integer; cdecl; external PolepairLibrary;
function pp_link_axis(Link: Pointer; Name: PAnsiChar; Length: NativeUInt; out Axis: Pointer): Integer; cdecl; external PolepairLibrary;
function pp_link_stop_all(Link: Pointer): Integer; cdecl; external PolepairLibrary;
function pp_link_sleep(Link: Pointer; Seconds: Double): Integer; cdecl; external PolepairLibrary;
function pp_simulation_act(Link: Pointer; Drive: NativeUInt; Act: PAnsiChar; Length: NativeUInt): Integer; cdecl; external PolepairLibrary;
procedure pp_axis_close(Axis: Pointer); cdecl; external PolepairLibrary;
function pp_axis_error(Axis: Pointer; var Error: TPolepairErrorRecord): Integer; cdecl; external PolepairLibrary;
function pp_axis_get_info(Axis: Pointer; var Info: TPolepairAxisInfo): Integer; cdecl; external PolepairLibrary;
function pp_axis_get(Axis: Pointer; Name: PAnsiChar; Length: NativeUInt; out Value: Double): Integer; cdecl; external PolepairLibrary;
function pp_axis_get_raw(Axis: Pointer; Name: PAnsiChar; Length: NativeUInt; out Value: Int64): Integer; cdecl; external PolepairLibrary;
function pp_axis_get_text(Axis: Pointer; Name: PAnsiChar; Length: NativeUInt; Buffer: PAnsiChar; Capacity: NativeUInt; out Needed: NativeUInt): Integer; cdecl; external PolepairLibrary;
function pp_axis_set(Axis: Pointer; Name: PAnsiChar; Length: NativeUInt; Value: Double): Integer; cdecl; external PolepairLibrary;
function pp_axis_set_raw(Axis: Pointer; Name: PAnsiChar; Length: NativeUInt; Value: Int64; Store: Integer): Integer; cdecl; external PolepairLibrary;
function pp_axis_set_text(Axis: Pointer; Name: PAnsiChar; Length: NativeUInt; Value: PAnsiChar; ValueLength: NativeUInt; Store: Integer): Integer; cdecl; external PolepairLibrary;
function pp_axis_parameter_count(Axis: Pointer; out Count: NativeUInt): Integer; cdecl; external PolepairLibrary;
function pp_axis_parameter_at(Axis: Pointer; Index: NativeUInt; var Parameter: TPolepairParameter): Integer; cdecl; external PolepairLibrary;
function pp_axis_has_signal(Axis: Pointer; Signal: Integer; out Has: Integer): Integer; cdecl; external PolepairLibrary;
function pp_axis_read(Axis: Pointer; Signal: Integer; out Value: Double): Integer; cdecl; external PolepairLibrary;
function pp_axis_arm(Axis: Pointer): Integer; cdecl; external PolepairLibrary;
function pp_axis_release(Axis: Pointer): Integer; cdecl; external PolepairLibrary;
function pp_axis_stop(Axis: Pointer): Integer; cdecl; external PolepairLibrary;
function pp_axis_wait(Axis: Pointer; Seconds: Double): Integer; cdecl; external PolepairLibrary;
function pp_axis_run(Axis: Pointer; Verb: Integer; Target: Double; Limits: Pointer): Integer; cdecl; external PolepairLibrary;
function pp_axis_run_text(Axis: Pointer; Verb: Integer; Target: PAnsiChar; Length: NativeUInt; Limits: Pointer): Integer; cdecl; external PolepairLibrary;
function pp_axis_begin(Axis: Pointer; Verb: Integer; Target: Double; Limits: Pointer; out Request: Pointer): Integer; cdecl; external PolepairLibrary;
function pp_request_wait(Request: Pointer; Seconds: Double): Integer; cdecl; external PolepairLibrary;
function pp_request_error(Request: Pointer; var Error: TPolepairErrorRecord): Integer; cdecl; external PolepairLibrary;
procedure pp_request_close(Request: Pointer); cdecl; external PolepairLibrary;
function pp_scan_open(Url: PAnsiChar; Length: NativeUInt; First, Last: Cardinal; out Scan: Pointer): Integer; cdecl; external PolepairLibrary;
function pp_scan_error(Scan: Pointer; var Error: TPolepairErrorRecord): Integer; cdecl; external PolepairLibrary;
function pp_scan_count(Scan: Pointer; out Count: NativeUInt): Integer; cdecl; external PolepairLibrary;
function pp_scan_at(Scan: Pointer; Index: NativeUInt; var Found: TPolepairFound): Integer; cdecl; external PolepairLibrary;
procedure pp_scan_close(Scan: Pointer); cdecl; external PolepairLibrary;

function NewError: TPolepairErrorRecord;
begin
  FillChar(Result, SizeOf(Result), 0);
  Result.Size := SizeOf(Result);
end;

constructor EPolepair.CreateOf(const Error: TPolepairErrorRecord);
begin
  inherited Create(string(PAnsiChar(@Error.Text)));
  Status := Error.Status;
  Code := string(PAnsiChar(@Error.Code));
  Hint := string(PAnsiChar(@Error.Hint));
  Executed := Error.Executed;
  MayTurn := Error.MayTurn <> 0;
end;

{ TPolepairAxis }

constructor TPolepairAxis.Create(Handle: Pointer);
begin
  inherited Create;
  FHandle := Handle;
end;

destructor TPolepairAxis.Destroy;
begin
  pp_axis_close(FHandle);
  inherited Destroy;
end;

procedure TPolepairAxis.Check(Status: Integer);
var
  Error: TPolepairErrorRecord;
begin
  if Status = PP_OK then
    Exit;
  Error := NewError;
  pp_axis_error(FHandle, Error);
  raise EPolepair.CreateOf(Error);
end;

function TPolepairAxis.Info: TPolepairAxisInfo;
begin
  FillChar(Result, SizeOf(Result), 0);
  Result.Size := SizeOf(Result);
  Check(pp_axis_get_info(FHandle, Result));
end;

function TPolepairAxis.Get(const Name: AnsiString): Double;
begin
  Check(pp_axis_get(FHandle, PAnsiChar(Name), Length(Name), Result));
end;

function TPolepairAxis.GetRaw(const Name: AnsiString): Int64;
begin
  Check(pp_axis_get_raw(FHandle, PAnsiChar(Name), Length(Name), Result));
end;

function TPolepairAxis.GetText(const Name: AnsiString): string;
var
  Buffer: AnsiString;
  Needed: NativeUInt;
  Status: Integer;
begin
  SetLength(Buffer, 128);
  repeat
    Status := pp_axis_get_text(FHandle, PAnsiChar(Name), Length(Name), PAnsiChar(Buffer), Length(Buffer), Needed);
    if Status = PP_BUFFER then
      SetLength(Buffer, Needed + 1);
  until Status <> PP_BUFFER;
  Check(Status);
  SetLength(Buffer, Needed);
  Result := string(Buffer);
end;

procedure TPolepairAxis.SetValue(const Name: AnsiString; Value: Double);
begin
  Check(pp_axis_set(FHandle, PAnsiChar(Name), Length(Name), Value));
end;

procedure TPolepairAxis.SetText(const Name, Value: AnsiString; Store: Boolean);
begin
  Check(pp_axis_set_text(FHandle, PAnsiChar(Name), Length(Name), PAnsiChar(Value), Length(Value), Ord(Store)));
end;

procedure TPolepairAxis.SetRaw(const Name: AnsiString; Value: Int64; Store: Boolean);
begin
  Check(pp_axis_set_raw(FHandle, PAnsiChar(Name), Length(Name), Value, Ord(Store)));
end;

function TPolepairAxis.ParameterCount: NativeUInt;
begin
  Check(pp_axis_parameter_count(FHandle, Result));
end;

function TPolepairAxis.ParameterAt(Index: NativeUInt): TPolepairParameter;
begin
  FillChar(Result, SizeOf(Result), 0);
  Result.Size := SizeOf(Result);
  Check(pp_axis_parameter_at(FHandle, Index, Result));
end;

function TPolepairAxis.HasSignal(Signal: TPolepairSignal): Boolean;
var
  Has: Integer;
begin
  Check(pp_axis_has_signal(FHandle, Ord(Signal), Has));
  Result := Has <> 0;
end;

function TPolepairAxis.Read(Signal: TPolepairSignal): Double;
begin
  Check(pp_axis_read(FHandle, Ord(Signal), Result));
end;

procedure TPolepairAxis.Arm;
begin
  Check(pp_axis_arm(FHandle));
end;

procedure TPolepairAxis.Release;
begin
  Check(pp_axis_release(FHandle));
end;

procedure TPolepairAxis.Stop;
begin
  Check(pp_axis_stop(FHandle));
end;

procedure TPolepairAxis.Run(Verb: TPolepairVerb; Target: Double);
begin
  Check(pp_axis_run(FHandle, Ord(Verb), Target, nil));
end;

procedure TPolepairAxis.RunText(Verb: TPolepairVerb; const Target: AnsiString);
begin
  Check(pp_axis_run_text(FHandle, Ord(Verb), PAnsiChar(Target), Length(Target), nil));
end;

procedure TPolepairAxis.Enable;
begin
  Run(pvEnable, 0);
end;

procedure TPolepairAxis.Disable;
begin
  Run(pvDisable, 0);
end;

procedure TPolepairAxis.Clear;
begin
  Run(pvClear, 0);
end;

function TPolepairAxis.Home(Seconds: Double): Boolean;
var
  Request: Pointer;
  Error: TPolepairErrorRecord;
  Status: Integer;
begin
  Check(pp_axis_begin(FHandle, Ord(pvHome), 0, nil, Request));
  try
    Status := pp_request_wait(Request, Seconds);
    if (Status <> PP_OK) and (Status <> PP_PENDING) then
    begin
      Error := NewError;
      pp_request_error(Request, Error);
      raise EPolepair.CreateOf(Error);
    end;
    Result := Status = PP_OK;
  finally
    pp_request_close(Request);
  end;
end;

procedure TPolepairAxis.Velocity(const Speed: AnsiString);
begin
  RunText(pvVelocity, Speed);
end;

procedure TPolepairAxis.MoveTo(const Position: AnsiString);
begin
  RunText(pvMoveTo, Position);
end;

procedure TPolepairAxis.MoveBy(const Distance: AnsiString);
begin
  RunText(pvMoveBy, Distance);
end;

procedure TPolepairAxis.Wait(Seconds: Double);
begin
  Check(pp_axis_wait(FHandle, Seconds));
end;

{ TPolepairLink }

constructor TPolepairLink.Create(const Url: AnsiString);
begin
  inherited Create;
  Check(pp_link_open(PAnsiChar(Url), Length(Url), FHandle));
end;

destructor TPolepairLink.Destroy;
begin
  pp_link_close(FHandle, nil);
  inherited Destroy;
end;

procedure TPolepairLink.Check(Status: Integer);
var
  Error: TPolepairErrorRecord;
begin
  if Status = PP_OK then
    Exit;
  Error := NewError;
  pp_link_error(FHandle, Error);
  raise EPolepair.CreateOf(Error);
end;

procedure TPolepairLink.Close;
var
  Error: TPolepairErrorRecord;
  Closing: Pointer;
begin
  Error := NewError;
  Closing := FHandle;
  FHandle := nil;
  if pp_link_close(Closing, @Error) <> PP_OK then
    raise EPolepair.CreateOf(Error);
end;

function TPolepairLink.AxisCount: NativeUInt;
begin
  Check(pp_link_axis_count(FHandle, Result));
end;

function TPolepairLink.AxisAt(Index: NativeUInt): TPolepairAxis;
var
  Axis: Pointer;
begin
  Check(pp_link_axis_at(FHandle, Index, Axis));
  Result := TPolepairAxis.Create(Axis);
end;

function TPolepairLink.Axis(const Name: AnsiString): TPolepairAxis;
var
  Axis: Pointer;
begin
  Check(pp_link_axis(FHandle, PAnsiChar(Name), Length(Name), Axis));
  Result := TPolepairAxis.Create(Axis);
end;

procedure TPolepairLink.StopAll;
begin
  Check(pp_link_stop_all(FHandle));
end;

procedure TPolepairLink.Sleep(Seconds: Double);
begin
  Check(pp_link_sleep(FHandle, Seconds));
end;

procedure TPolepairLink.Act(Drive: NativeUInt; const What: AnsiString);
begin
  Check(pp_simulation_act(FHandle, Drive, PAnsiChar(What), Length(What)));
end;

function PolepairScan(const Url: AnsiString; First, Last: Cardinal): TPolepairFoundArray;
var
  Scan: Pointer;
  Count, I: NativeUInt;
  Error: TPolepairErrorRecord;
begin
  SetLength(Result, 0);
  if pp_scan_open(PAnsiChar(Url), Length(Url), First, Last, Scan) <> PP_OK then
  begin
    Error := NewError;
    pp_scan_error(Scan, Error);
    pp_scan_close(Scan);
    raise EPolepair.CreateOf(Error);
  end;
  pp_scan_count(Scan, Count);
  SetLength(Result, Count);
  I := 0;
  while I < Count do
  begin
    FillChar(Result[I], SizeOf(Result[I]), 0);
    Result[I].Size := SizeOf(Result[I]);
    pp_scan_at(Scan, I, Result[I]);
    Inc(I);
  end;
  pp_scan_close(Scan);
end;

initialization
  { The library computes with NaN, as C programs do. Threads of the library take this over. }
  SetExceptionMask([exInvalidOp, exDenormalized, exZeroDivide, exOverflow, exUnderflow, exPrecision]);

end.
