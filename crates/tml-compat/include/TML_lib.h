/* TML_lib.h: the functions of Technosoft's TML_LIB, as libTML_lib of Polepair has them.
 *
 * This header is Polepair's own, and Polepair is not affiliated with Technosoft. Names, arguments and constants are
 * those that programs for TML_LIB use, so that a program compiles without changes.
 *
 * Results: BOOL functions return TRUE when the drive has confirmed. After FALSE, TS_GetLastErrorText() says why.
 * Threads: each thread has its own channel and axis; one that has selected none uses what was selected last.
 * Units: positions in counts, speeds in counts per slow loop, accelerations in counts per slow loop squared.
 * Motion: closing a channel or leaving the program stops no motor: call TS_Stop and TS_Power(POWER_OFF) first.
 * Results of functions are references in C++ and pointers in C.
 */
#ifndef POLEPAIR_TML_LIB_H
#define POLEPAIR_TML_LIB_H

#include <stdint.h>

#if defined(_WIN32) && !defined(_WIN64)
#define TML_EXPORT __stdcall
#else
#define TML_EXPORT
#endif

#ifdef __cplusplus
#define TML_OUT(type) type &
#define TML_DEFAULT(value) = value
#else
#define TML_OUT(type) type *
#define TML_DEFAULT(value)
#endif

#ifndef _WINDEF_
typedef uint8_t BYTE;
typedef uint16_t WORD;
#ifdef _WIN32
typedef unsigned long DWORD;
#else
typedef uint32_t DWORD;
#endif
typedef int BOOL;
#endif
#ifndef _WINNT_
typedef const char *LPCSTR;
typedef char *LPSTR;
#endif
#ifndef FALSE
#define FALSE 0
#endif
#ifndef TRUE
#define TRUE 1
#endif

/* Channels: type for TS_OpenChannel. On CAN, add PROTOCOL_TECHNOCAN for TechnoCAN instead of TMLCAN. */
#define PROTOCOL_TMLCAN 0x00
#define PROTOCOL_TECHNOCAN 0x80
#define CHANNEL_RS232 0
#define CHANNEL_RS485 1
#define CHANNEL_IXXAT_CAN 2
#define CHANNEL_SYS_TEC_USBCAN 3
#define CHANNEL_PEAK_SYS_PCAN_PCI 4
#define CHANNEL_ESD_CAN 5
#define CHANNEL_PEAK_SYS_PCAN_ISA 6
#define CHANNEL_PEAK_SYS_PCAN_PC104 CHANNEL_PEAK_SYS_PCAN_ISA
#define CHANNEL_PEAK_SYS_PCAN_USB 7
#define CHANNEL_PEAK_SYS_PCAN_DONGLE 8
#define CHANNEL_LAWICEL_USBCAN 9
#define CHANNEL_VIRTUAL_SERIAL 15
#define CHANNEL_XPORT_IP 16
#ifndef HOST_ID
#define HOST_ID 1
#endif

/* Power: TS_Power. */
#define POWER_ON 1
#define POWER_OFF 0

/* Registers: TS_ReadStatus. */
#define REG_MCR 0
#define REG_MSR 1
#define REG_ISR 2
#define REG_SRL 3
#define REG_SRH 4
#define REG_MER 5
#define REG_DER 6
#define REG_DER2 7

/* Motion: when it begins, and from where. */
#define UPDATE_NONE -1
#define UPDATE_ON_EVENT 0
#define UPDATE_IMMEDIATE 1
#define FROM_MEASURE 0
#define FROM_REFERENCE 1
#define FULL_RANGE 0
#define NO_VARIATION 0

/* External references. */
#define REFERENCE_POSITION 0
#define REFERENCE_SPEED 1
#define REFERENCE_TORQUE 2
#define REFERENCE_VOLTAGE 3

/* S-curves, positions, superposition, slaves. */
#define S_CURVE_SPEED_PROFILE 0
#define TRAPEZOIDAL_SPEED_PROFILE 1
#define ABSOLUTE_POSITION 0
#define RELATIVE_POSITION 1
#define SUPERPOS_DISABLE -1
#define SUPERPOS_NONE 0
#define SUPERPOS_ENABLE 1
#define SLAVE_NONE 0
#define SLAVE_COMMUNICATION_CHANNEL 1
#define SLAVE_2ND_ENCODER 2

/* Events. */
#define TRANSITION_HIGH_TO_LOW -1
#define TRANSITION_DISABLE 0
#define TRANSITION_LOW_TO_HIGH 1
#define INDEX_1 1
#define INDEX_2 2
#define LSW_NEGATIVE -1
#define LSW_POSITIVE 1

/* Lines. */
#define IO_LOW 0
#define IO_HIGH 1
#define INPUT_0 0
#define INPUT_1 1
#define INPUT_2 2
#define INPUT_3 3
#define INPUT_4 4
#define INPUT_5 5
#define INPUT_6 6
#define INPUT_7 7
#define INPUT_8 8
#define INPUT_9 9
#define INPUT_10 10
#define INPUT_11 11
#define INPUT_12 12
#define INPUT_13 13
#define INPUT_14 14
#define INPUT_15 15
#define INPUT_16 16
#define INPUT_17 17
#define INPUT_18 18
#define INPUT_19 19
#define INPUT_20 20
#define INPUT_21 21
#define INPUT_22 22
#define INPUT_23 23
#define INPUT_24 24
#define INPUT_25 25
#define INPUT_26 26
#define INPUT_27 27
#define INPUT_28 28
#define INPUT_29 29
#define INPUT_30 30
#define INPUT_31 31
#define INPUT_32 32
#define INPUT_33 33
#define INPUT_34 34
#define INPUT_35 35
#define INPUT_36 36
#define INPUT_37 37
#define INPUT_38 38
#define INPUT_39 39
#define OUTPUT_0 0
#define OUTPUT_1 1
#define OUTPUT_2 2
#define OUTPUT_3 3
#define OUTPUT_4 4
#define OUTPUT_5 5
#define OUTPUT_6 6
#define OUTPUT_7 7
#define OUTPUT_8 8
#define OUTPUT_9 9
#define OUTPUT_10 10
#define OUTPUT_11 11
#define OUTPUT_12 12
#define OUTPUT_13 13
#define OUTPUT_14 14
#define OUTPUT_15 15
#define OUTPUT_16 16
#define OUTPUT_17 17
#define OUTPUT_18 18
#define OUTPUT_19 19
#define OUTPUT_20 20
#define OUTPUT_21 21
#define OUTPUT_22 22
#define OUTPUT_23 23
#define OUTPUT_24 24
#define OUTPUT_25 25
#define OUTPUT_26 26
#define OUTPUT_27 27
#define OUTPUT_28 28
#define OUTPUT_29 29
#define OUTPUT_30 30
#define OUTPUT_31 31
#define OUTPUT_32 32
#define OUTPUT_33 33
#define OUTPUT_34 34
#define OUTPUT_35 35
#define OUTPUT_36 36
#define OUTPUT_37 37
#define OUTPUT_38 38
#define OUTPUT_39 39
#define GROUP_0 0
#define GROUP_1 1
#define GROUP_2 2
#define GROUP_3 3
#define GROUP_4 4
#define GROUP_5 5
#define GROUP_6 6
#define GROUP_7 7
#define GROUP_8 8

/* The logger. */
#define LOGGER_SLOW 1
#define LOGGER_FAST 2

#ifdef _WIN32
typedef void(__stdcall *pfnCallbackRecvDriveMsg)(WORD axis, WORD address, long value);
#else
typedef void (*pfnCallbackRecvDriveMsg)(WORD axis, WORD address, long value);
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* --- Channels and set-ups ------------------------------------------------------------------------------------- */

/* Text of the calling thread's last error. Valid until the thread's next function fails. */
LPCSTR TML_EXPORT TS_GetLastErrorText(void);
/* The same, copied into a buffer of so many bytes. */
void TML_EXPORT TS_Basic_GetLastErrorText(LPSTR buffer, int capacity);

/* Opens a channel, selects it and returns its descriptor, or -1.
 *
 * device: a port ("/dev/ttyUSB0", "COM1"), a CAN interface ("can0"), the address of a serial server
 *     ("10.0.0.5:4001"), or one of Polepair's connection strings ("tmlcan+socketcand://10.0.0.5/can0", "sim:tml").
 * host: on RS-232 the axis ID of the drive at the cable; on RS-485 and CAN an axis ID that no drive has. */
int TML_EXPORT TS_OpenChannel(LPCSTR device, BYTE type, BYTE host, DWORD baud);
/* Selects an open channel for the calling thread. */
BOOL TML_EXPORT TS_SelectChannel(int channel);
/* Closes a channel, or the selected one (-1). The drives stay as they are. */
void TML_EXPORT TS_CloseChannel(int channel TML_DEFAULT(-1));
/* Loads a set-up archive (.t.zip), or a folder with variables.cfg, and returns its index, or -1. */
int TML_EXPORT TS_LoadSetup(LPCSTR path);
/* Give an axis (1 to 255), a group (1 to 8) or everybody the names of a set-up. */
BOOL TML_EXPORT TS_SetupAxis(BYTE axis, int setup);
BOOL TML_EXPORT TS_SetupGroup(BYTE group, int setup);
BOOL TML_EXPORT TS_SetupBroadcast(int setup);
/* Have the thread's commands go to an axis, a group or everybody that is set up. */
BOOL TML_EXPORT TS_SelectAxis(BYTE axis);
BOOL TML_EXPORT TS_SelectGroup(BYTE group);
BOOL TML_EXPORT TS_SelectBroadcast(void);

/* --- Power and status ----------------------------------------------------------------------------------------- */

/* Checks that the drive's set-up table is valid, sends ENDINIT, and waits until it was executed. */
BOOL TML_EXPORT TS_DriveInitialisation(void);
/* RESET; FAULTR; SAVE, which writes the drive's EEPROM. */
BOOL TML_EXPORT TS_Reset(void);
BOOL TML_EXPORT TS_ResetFault(void);
BOOL TML_EXPORT TS_Save(void);
/* AXISON or AXISOFF. The motor has power when bit 15 of REG_SRL is set. */
BOOL TML_EXPORT TS_Power(BOOL enable);
/* Reads a register: REG_MCR to REG_DER2. */
BOOL TML_EXPORT TS_ReadStatus(short which, TML_OUT(WORD) status);
/* UPD and UPD!. */
BOOL TML_EXPORT TS_UpdateImmediate(void);
BOOL TML_EXPORT TS_UpdateOnEvent(void);
/* SAP; IDRSTEP, the current of a stepper; STA. */
BOOL TML_EXPORT TS_SetPosition(long position);
BOOL TML_EXPORT TS_SetCurrent(short current);
BOOL TML_EXPORT TS_SetTargetPositionToActual(void);
/* STOP, which leaves the motor its power; CDEC, the deceleration of quick stops. */
BOOL TML_EXPORT TS_Stop(void);
BOOL TML_EXPORT TS_QuickStopDecelerationRate(double deceleration);

/* --- Variables and memory ------------------------------------------------------------------------------------- */

/* The address of a variable in data memory, by the set-up. Nothing is sent. */
BOOL TML_EXPORT TS_GetVariableAddress(LPCSTR name, TML_OUT(WORD) address);
/* Variables by name: 16 bits, 32 bits, 16.16 fixed point. A function for another type is refused. */
BOOL TML_EXPORT TS_SetIntVariable(LPCSTR name, short value);
BOOL TML_EXPORT TS_GetIntVariable(LPCSTR name, TML_OUT(short) value);
BOOL TML_EXPORT TS_SetLongVariable(LPCSTR name, long value);
BOOL TML_EXPORT TS_GetLongVariable(LPCSTR name, TML_OUT(long) value);
BOOL TML_EXPORT TS_SetFixedVariable(LPCSTR name, double value);
BOOL TML_EXPORT TS_GetFixedVariable(LPCSTR name, TML_OUT(double) value);
/* Internal units of position in one turn of the motor. */
BOOL TML_EXPORT TS_GetMotorPositionScalingFactor(TML_OUT(double) factor);
/* Words of program memory and EEPROM, from address 0x4000 on. Writing needs a motor without power. */
BOOL TML_EXPORT TS_SetBuffer(WORD address, const WORD *words, WORD count);
BOOL TML_EXPORT TS_GetBuffer(WORD address, WORD *words, WORD count);
/* The drive's sum of the words from start to end, modulo 65536. */
BOOL TML_EXPORT TS_OnlineChecksum(WORD start, WORD end, TML_OUT(WORD) sum);

/* --- Motion. Speed 0 and acceleration 0 keep the values before. ----------------------------------------------- */

BOOL TML_EXPORT TS_MoveAbsolute(long position, double speed, double acceleration, short moment, short base);
BOOL TML_EXPORT TS_MoveRelative(long distance, double speed, double acceleration, BOOL additive, short moment,
                                short base);
BOOL TML_EXPORT TS_MoveVelocity(double speed, double acceleration, short moment, short base);
BOOL TML_EXPORT TS_MoveSCurveAbsolute(long position, double speed, double acceleration, long jerk_time, short moment,
                                      short deceleration);
BOOL TML_EXPORT TS_MoveSCurveRelative(long distance, double speed, double acceleration, long jerk_time, short moment,
                                      short deceleration);
BOOL TML_EXPORT TS_SetAnalogueMoveExternal(short reference, BOOL fast, double limit, short moment);
BOOL TML_EXPORT TS_SetDigitalMoveExternal(BOOL set_ratio TML_DEFAULT(FALSE), short denominator TML_DEFAULT(1),
                                          short numerator TML_DEFAULT(1), double limit TML_DEFAULT(0),
                                          short moment TML_DEFAULT(1));
BOOL TML_EXPORT TS_SetOnlineMoveExternal(short reference, double limit TML_DEFAULT(0), double initial TML_DEFAULT(0),
                                         short moment TML_DEFAULT(1));
BOOL TML_EXPORT TS_VoltageTestMode(short max, short increment, short angle, short angle_increment, short moment);
BOOL TML_EXPORT TS_TorqueTestMode(short max, short increment, short angle, short angle_increment, short moment);

/* --- Gears and cams ------------------------------------------------------------------------------------------- */

/* set_slave_position must be FALSE: the instruction for it is not public. */
BOOL TML_EXPORT TS_SetGearingMaster(BOOL group, BYTE slave, short base, BOOL enable, BOOL set_slave_position,
                                    short moment);
BOOL TML_EXPORT TS_SetGearingSlave(short denominator, short numerator, short base, short enable, double limit,
                                   short moment);
BOOL TML_EXPORT TS_MotionSuperposition(short enable, short update);
BOOL TML_EXPORT TS_SetCammingMaster(BOOL group, BYTE slave, short base, BOOL enable, short moment);
BOOL TML_EXPORT TS_CamInitialization(WORD load, WORD run);
BOOL TML_EXPORT TS_SetCammingSlaveRelative(WORD run, short base, short enable, short moment,
                                           long offset TML_DEFAULT(0), double input_factor TML_DEFAULT(0),
                                           double output_factor TML_DEFAULT(0));
BOOL TML_EXPORT TS_SetCammingSlaveAbsolute(WORD run, double limit, short base, short enable, short moment,
                                           long offset TML_DEFAULT(0), double input_factor TML_DEFAULT(0),
                                           double output_factor TML_DEFAULT(0));
BOOL TML_EXPORT TS_SetMasterResolution(int counts);
BOOL TML_EXPORT TS_SendSynchronization(int period);

/* --- Paths of points. The counter of a point is 0 to 127. ------------------------------------------------------ */

BOOL TML_EXPORT TS_PVTSetup(short clear, short check, short change_counter, short from_target, short change_low_level,
                            short counter, short low_level);
BOOL TML_EXPORT TS_SendPVTFirstPoint(long position, double velocity, int time, short counter, short kind, long initial,
                                     short moment, short base);
BOOL TML_EXPORT TS_SendPVTPoint(long position, double velocity, unsigned int time, short counter);
BOOL TML_EXPORT TS_PTSetup(short clear, short check, short change_counter, short from_target, short change_low_level,
                           short counter, short low_level);
BOOL TML_EXPORT TS_SendPTFirstPoint(long position, int time, short counter, short kind, long initial, short moment,
                                    short base);
BOOL TML_EXPORT TS_SendPTPoint(long position, unsigned int time, short counter);

/* --- Events. wait: return when the event occurs, or at a fault. stop: stop the motor at the event. -------------- */

BOOL TML_EXPORT TS_CheckEvent(TML_OUT(BOOL) occurred);
BOOL TML_EXPORT TS_SetEventOnMotionComplete(BOOL wait, BOOL stop);
BOOL TML_EXPORT TS_SetEventOnMotorPosition(short kind, long position, BOOL over, BOOL wait, BOOL stop);
BOOL TML_EXPORT TS_SetEventOnLoadPosition(short kind, long position, BOOL over, BOOL wait, BOOL stop);
BOOL TML_EXPORT TS_SetEventOnMotorSpeed(double speed, BOOL over, BOOL wait, BOOL stop);
BOOL TML_EXPORT TS_SetEventOnLoadSpeed(double speed, BOOL over, BOOL wait, BOOL stop);
BOOL TML_EXPORT TS_SetEventOnTime(WORD time, BOOL wait, BOOL stop);
BOOL TML_EXPORT TS_SetEventOnPositionRef(long position, BOOL over, BOOL wait, BOOL stop);
BOOL TML_EXPORT TS_SetEventOnSpeedRef(double speed, BOOL over, BOOL wait, BOOL stop);
BOOL TML_EXPORT TS_SetEventOnTorqueRef(int torque, BOOL over, BOOL wait, BOOL stop);
BOOL TML_EXPORT TS_SetEventOnEncoderIndex(short index, short transition, BOOL wait, BOOL stop);
BOOL TML_EXPORT TS_SetEventOnLimitSwitch(short which, short transition, BOOL wait, BOOL stop);
BOOL TML_EXPORT TS_SetEventOnDigitalInput(BYTE line, short state, BOOL wait, BOOL stop);

/* --- Lines 0 to 15 --------------------------------------------------------------------------------------------- */

BOOL TML_EXPORT TS_SetupInput(BYTE line);
BOOL TML_EXPORT TS_GetInput(BYTE line, TML_OUT(BYTE) value);
BOOL TML_EXPORT TS_SetupOutput(BYTE line);
BOOL TML_EXPORT TS_SetOutput(BYTE line, BYTE value);
BOOL TML_EXPORT TS_GetMultipleInputs(LPCSTR name, TML_OUT(short) values);
/* Outputs 0 to 15. `name` is not needed. */
BOOL TML_EXPORT TS_SetMultipleOutputs(LPCSTR name, short values);
BOOL TML_EXPORT TS_SetMultipleOutputs2(short lines, short values);

/* --- Programs and instructions ---------------------------------------------------------------------------------- */

/* Instructions as text ("CPOS = 1000; UPD"). All are checked before the first is sent. */
BOOL TML_EXPORT TS_Execute(LPCSTR commands);
BOOL TML_EXPORT TS_ExecuteScript(LPCSTR file);
/* The instructions that the thread's last function sent. */
BOOL TML_EXPORT TS_GetOutputOfExecute(LPSTR buffer, int capacity);
/* A .sw file, or a program in TML's text; object files (.out) are refused. EEPROM is written and verified. */
BOOL TML_EXPORT TS_DownloadProgram(LPCSTR file, TML_OUT(WORD) entry);
BOOL TML_EXPORT TS_DownloadSwFile(LPCSTR file);
BOOL TML_EXPORT TS_GOTO(WORD address);
BOOL TML_EXPORT TS_CALL(WORD address);
BOOL TML_EXPORT TS_CancelableCALL(WORD address);
BOOL TML_EXPORT TS_ABORT(void);
/* Labels of the program in TML's text that TS_DownloadProgram has downloaded to the selected axis. */
BOOL TML_EXPORT TS_GOTO_Label(LPCSTR label);
BOOL TML_EXPORT TS_CALL_Label(LPCSTR label);
BOOL TML_EXPORT TS_CancelableCALL_Label(LPCSTR label);

/* --- The drive's data logger ---------------------------------------------------------------------------------------
 * The buffer is RAM of the drive that nothing else uses: 0x8270 to 0x87FF has no variables. The layout of its head is
 * inferred: try it first with a motor that nothing depends on. */

/* `addresses` are those of 16-bit words; a variable of 32 bits has two, the low one first. */
BOOL TML_EXPORT TS_SetupLogger(WORD buffer, WORD length, const WORD *addresses, WORD count, WORD period);
BOOL TML_EXPORT TS_StartLogger(WORD buffer, BYTE kind);
/* 0 when the log is complete. */
BOOL TML_EXPORT TS_CheckLoggerStatus(WORD buffer, TML_OUT(WORD) left);
/* `count` is the room in `values`, and becomes the number of words. */
BOOL TML_EXPORT TS_UploadLoggerResults(WORD buffer, WORD *values, TML_OUT(WORD) count);

/* --- Messages that drives send without being asked --------------------------------------------------------------- */

BOOL TML_EXPORT TS_SendDataToHost(BYTE host, DWORD status_bits, WORD error_bits);
void TML_EXPORT TS_RegisterHandlerForUnrequestedDriveMessages(pfnCallbackRecvDriveMsg handler);
/* Calls the handler in the calling thread, once for each message since the last check. */
BOOL TML_EXPORT TS_CheckForUnrequestedDriveMessages(void);

/* --- Not supported: each returns FALSE, sends nothing, and TS_GetLastErrorText says why --------------------------- */

BOOL TML_EXPORT TS_CamDownload(LPCSTR file, WORD load, WORD run, TML_OUT(WORD) next_load, TML_OUT(WORD) next_run);
BOOL TML_EXPORT TS_GetHomeInput(TML_OUT(BYTE) value);
BOOL TML_EXPORT TS_SetEventOnHomeInput(short state, BOOL wait, BOOL stop);
BOOL TML_EXPORT TS_GetFirmwareVersion(TML_OUT(int) version);
BOOL TML_EXPORT TS_GetLoadPositionScalingFactor(TML_OUT(double) factor);
BOOL TML_EXPORT TS_GetTimeScalingFactor(TML_OUT(double) factor);

#ifdef __cplusplus
}
#endif

#endif
