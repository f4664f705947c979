/* Each function of TML_lib.h against simulated drives: what it sends, what it reads, what it refuses.
 * Arguments: a set-up archive, and a folder for files. */
#define _POSIX_C_SOURCE 200809L
#include <TML_lib.h>

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#define DRIVES "sim:tmlcan?axes=2"

#define FAIL(text) \
    do { \
        fprintf(stderr, "line %d: %s (%s)\n", __LINE__, text, TS_GetLastErrorText()); \
        exit(1); \
    } while (0)
#define EXPECT(condition) \
    do { \
        if (!(condition)) \
            FAIL(#condition); \
    } while (0)
/* The call fails, and its error says this. */
#define REFUSED(call, word) \
    do { \
        if (call) \
            FAIL(#call " was done"); \
        if (strstr(TS_GetLastErrorText(), word) == NULL) \
            FAIL(#call " has another error"); \
    } while (0)
/* The call sends these instructions. */
#define SENDS(call, text) \
    do { \
        char sent[512]; \
        EXPECT(call); \
        EXPECT(TS_GetOutputOfExecute(sent, sizeof sent)); \
        if (strcmp(sent, text) != 0) { \
            fprintf(stderr, "line %d: %s sent\n%s", __LINE__, #call, sent); \
            exit(1); \
        } \
    } while (0)

/* A variable of 32 bits has this value. */
#define READS(name, expected) \
    do { \
        long found = read_long(name); \
        if (found != (expected)) { \
            fprintf(stderr, "line %d: %s is %ld, not %ld\n", __LINE__, name, found, (long)(expected)); \
            exit(1); \
        } \
    } while (0)

static const char *setup;
static const char *folder;

static void pause_ms(long ms)
{
    struct timespec span = { ms / 1000, ms % 1000 * 1000000 };

    nanosleep(&span, NULL);
}

static int open_device(const char *device)
{
    int index, channel = TS_OpenChannel(device, CHANNEL_RS232, 1, 115200);

    EXPECT(channel >= 0);
    EXPECT((index = TS_LoadSetup(setup)) >= 0);
    EXPECT(TS_LoadSetup(setup) == index);
    EXPECT(TS_SetupAxis(1, index) && TS_SetupAxis(2, index) && TS_SetupGroup(1, index) && TS_SetupBroadcast(index));
    return channel;
}

static int open_axes(void)
{
    return open_device(DRIVES);
}

static void power(BYTE axis)
{
    WORD status = 0;

    EXPECT(TS_SelectAxis(axis));
    EXPECT(TS_DriveInitialisation());
    EXPECT(TS_Power(POWER_ON));
    while ((status & 1 << 15) == 0)
        EXPECT(TS_ReadStatus(REG_SRL, &status));
}

static long read_long(const char *name)
{
    long value = 0x5555;

    EXPECT(TS_GetLongVariable(name, &value));
    return value;
}

static void test_what_comes_first(void)
{
    char text[16];
    WORD status;

    REFUSED(TS_Stop(), "TS_OpenChannel");
    REFUSED(TS_OpenChannel("/dev/not-there", CHANNEL_RS232, 1, 9600) >= 0, "/dev/not-there");
    REFUSED(TS_OpenChannel("COM1", CHANNEL_VIRTUAL_SERIAL, 1, 9600) >= 0, "15");
    REFUSED(TS_OpenChannel("sim:tmcl", CHANNEL_RS232, 1, 9600) >= 0, "g*");
    REFUSED(TS_OpenChannel(NULL, CHANNEL_RS232, 1, 9600) >= 0, "NULL");
    REFUSED(TS_LoadSetup("not-there.t.zip") >= 0, "not-there.t.zip");
    TS_Basic_GetLastErrorText(text, sizeof text);
    EXPECT(strlen(text) == sizeof text - 1 && strncmp(text, "TS_LoadSetup", 12) == 0);
    open_axes();
    REFUSED(TS_Stop(), "TS_SelectAxis");
    REFUSED(TS_SelectAxis(3), "TS_SetupAxis");
    REFUSED(TS_SetupAxis(1, 99), "TS_LoadSetup");
    REFUSED(TS_SetupGroup(9, 0), "1 to 8");
    EXPECT(TS_SelectAxis(1));
    REFUSED(TS_ReadStatus(8, &status), "DER2");
    REFUSED(TS_ReadStatus(REG_SRL, NULL), "NULL");
    TS_CloseChannel(-1);
    REFUSED(TS_Stop(), "TS_OpenChannel");
    REFUSED(TS_SelectChannel(0), "not open");
}

static void test_moves(void)
{
    BOOL occurred = FALSE;
    double speed = 0;
    int channel = open_axes();

    power(1);
    SENDS(TS_MoveAbsolute(2000, 20.5, 0.5, UPDATE_IMMEDIATE, FROM_REFERENCE),
          "CPOS = 2000;\nCSPD = 20.5;\nCACC = 0.5;\nMODE PP;\nCPA;\nTUM1;\nUPD;\n");
    EXPECT(TS_SetEventOnMotionComplete(TRUE, FALSE));
    READS("TPOS", 2000);
    SENDS(TS_MoveRelative(-3000, 0, 0, FALSE, UPDATE_IMMEDIATE, FROM_REFERENCE),
          "CPOS = -3000;\nSRBL ACR, 0xF7FF, 0x0000;\nMODE PP;\nCPR;\nTUM1;\nUPD;\n");
    EXPECT(TS_SetEventOnMotionComplete(TRUE, FALSE));
    READS("TPOS", -1000);
    EXPECT(TS_MoveRelative(500, 0, 0, TRUE, UPDATE_NONE, FROM_REFERENCE));
    READS("TPOS", -1000);
    EXPECT(TS_UpdateImmediate() && TS_SetEventOnMotionComplete(TRUE, FALSE));
    READS("TPOS", -500);
    SENDS(TS_MoveSCurveAbsolute(0, 10, 0.2, 20, UPDATE_IMMEDIATE, S_CURVE_SPEED_PROFILE),
          "CPOS = 0;\nCSPD = 10;\nCACC = 0.2;\nTJERK = 20;\nSRBL ACR, 0xFFFE, 0x0000;\nMODE PSC;\nCPA;\n"
          "TUM1;\nUPD;\n");
    EXPECT(TS_SetEventOnMotionComplete(TRUE, FALSE));
    READS("TPOS", 0);
    EXPECT(TS_MoveSCurveRelative(1000, 10, 0.2, 20, UPDATE_IMMEDIATE, TRAPEZOIDAL_SPEED_PROFILE));
    EXPECT(TS_SetEventOnMotionComplete(TRUE, FALSE));
    READS("TPOS", 1000);

    EXPECT(TS_MoveVelocity(-5, 0.5, UPDATE_IMMEDIATE, FROM_REFERENCE));
    SENDS(TS_SetEventOnLoadPosition(ABSOLUTE_POSITION, -500, FALSE, TRUE, TRUE),
          "!ALPU -500;\nSTOP!;\n");
    EXPECT(TS_CheckEvent(&occurred) && occurred && read_long("APOS") < -500);
    EXPECT(TS_Stop() && TS_Power(POWER_OFF));
    do
        EXPECT(TS_GetFixedVariable("ASPD", &speed));
    while (speed != 0);
    EXPECT(TS_SetPosition(77));
    READS("APOS", 77);
    EXPECT(TS_SetTargetPositionToActual());

    REFUSED(TS_MoveAbsolute(3000000000L, 1, 1, 1, 1), "32 bits");
    REFUSED(TS_MoveAbsolute(1, 40000, 1, 1, 1), "32768");
    REFUSED(TS_MoveAbsolute(1, 1, 1, 2, 1), "MoveMoment");
    REFUSED(TS_MoveAbsolute(1, 1, 1, 1, 2), "ReferenceBase");
    TS_CloseChannel(channel);
}

static void test_variables(void)
{
    double fixed = 0;
    short word = 0;
    WORD address = 0;

    open_axes();
    EXPECT(TS_SelectAxis(2));
    EXPECT(TS_SetIntVariable("VAR_I1", -123) && TS_GetIntVariable("VAR_I1", &word) && word == -123);
    EXPECT(TS_SetLongVariable("VAR_LF", -70000));
    READS("VAR_LF", -70000);
    EXPECT(TS_GetMotorPositionScalingFactor(&fixed) && fixed == 2000);
    EXPECT(TS_SetFixedVariable("CSPD", -12.25) && TS_GetFixedVariable("CSPD", &fixed) && fixed == -12.25);
    EXPECT(TS_GetVariableAddress("APOS", &address) && address == 0x0228);
    REFUSED(TS_GetIntVariable("APOS", &word), "TS_GetLongVariable");
    REFUSED(TS_SetFixedVariable("APOS", 1), "TS_SetLongVariable");
    REFUSED(TS_GetIntVariable("NOTHING", &word), "NOTHING");
    REFUSED(TS_SetFixedVariable("CSPD", 1e9), "out of range");
    EXPECT(TS_SelectBroadcast() && TS_SetIntVariable("VAR_I1", 5));
    REFUSED(TS_GetIntVariable("VAR_I1", &word), "TS_SelectAxis");
    EXPECT(TS_SelectAxis(1) && TS_GetIntVariable("VAR_I1", &word) && word == 5);
    EXPECT(TS_SelectAxis(2) && TS_GetIntVariable("VAR_I1", &word) && word == 5);

    SENDS(TS_Execute("VAR_I1 = 6; // six\n VAR_I2 = 0x10;"), "VAR_I1 = 6;\nVAR_I2 = 0x10;\n");
    EXPECT(TS_GetIntVariable("VAR_I2", &word) && word == 16);
    /* Nothing of a text with an error is sent. */
    REFUSED(TS_Execute("VAR_I1 = 7; CPOS ="), "expected");
    EXPECT(TS_GetIntVariable("VAR_I1", &word) && word == 6);
    EXPECT(TS_Execute("var_i1 = 0x03B0; (var_i1),dm = 9"));
    TS_CloseChannel(-1);
}

static void test_events_and_lines(void)
{
    BOOL occurred = TRUE;
    BYTE input = 9;
    short inputs = -1;

    open_axes();
    power(1);
    EXPECT(TS_SetEventOnTime(50, TRUE, FALSE));
    SENDS(TS_SetEventOnMotorSpeed(1.5, TRUE, FALSE, FALSE), "!MSO 1.5;\n");
    EXPECT(TS_CheckEvent(&occurred) && !occurred);
    SENDS(TS_SetEventOnLoadSpeed(1.5, FALSE, FALSE, FALSE), "!LSU 1.5;\n");
    SENDS(TS_SetEventOnMotorPosition(RELATIVE_POSITION, 9, TRUE, FALSE, FALSE), "!RMPO 9;\n");
    SENDS(TS_SetEventOnPositionRef(9, FALSE, FALSE, FALSE), "!PRU 9;\n");
    SENDS(TS_SetEventOnSpeedRef(9, TRUE, FALSE, FALSE), "!SRO 9;\n");
    SENDS(TS_SetEventOnTorqueRef(9, TRUE, FALSE, FALSE), "!TRO 9;\n");
    SENDS(TS_SetEventOnEncoderIndex(INDEX_1, TRANSITION_LOW_TO_HIGH, FALSE, FALSE), "ENCAPI1;\n!CAP;\n");
    SENDS(TS_SetEventOnEncoderIndex(INDEX_2, TRANSITION_HIGH_TO_LOW, FALSE, FALSE), "EN2CAPI0;\n!CAP;\n");
    SENDS(TS_SetEventOnLimitSwitch(LSW_NEGATIVE, TRANSITION_LOW_TO_HIGH, FALSE, FALSE), "ENLSN1;\n!LSN;\n");
    SENDS(TS_SetEventOnLimitSwitch(LSW_POSITIVE, TRANSITION_DISABLE, FALSE, FALSE), "DISLSP;\n");
    SENDS(TS_SetEventOnDigitalInput(3, IO_HIGH, FALSE, FALSE), "!IN#3 1;\n");
    REFUSED(TS_SetEventOnDigitalInput(16, IO_HIGH, FALSE, FALSE), "0 to 15");
    EXPECT(TS_GetInput(0, &input) && input <= 1);
    EXPECT(TS_GetMultipleInputs("VAR_I1", &inputs) && (inputs & 1) == input);
    SENDS(TS_SetOutput(2, 1), "OUT(2) = 4;\n");
    SENDS(TS_SetMultipleOutputs2(5, 4), "OUT(0, 2) = 4;\n");
    SENDS(TS_SetMultipleOutputs("VAR_I1", 3), "OUT(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15) = 3;\n");
    SENDS(TS_SetupOutput(2), "SetAsOutput(2);\n");
    SENDS(TS_SetupInput(2), "SetAsInput(2);\n");
    REFUSED(TS_SetOutput(2, 2), "not 0 or 1");
    EXPECT(TS_Power(POWER_OFF));
    TS_CloseChannel(-1);
}

static void test_modes(void)
{
    open_axes();
    power(1);
    EXPECT(TS_Power(POWER_OFF));
    SENDS(TS_SetAnalogueMoveExternal(REFERENCE_SPEED, FALSE, 0.5, UPDATE_NONE),
          "EXTREF 1;\nCACC = 0.5;\nSRBL UPGRADE, 0xFFFF, 0x0004;\nMODE SE;\n");
    SENDS(TS_SetAnalogueMoveExternal(REFERENCE_TORQUE, TRUE, NO_VARIATION, UPDATE_NONE), "EXTREF 1;\nMODE TEF;\n");
    REFUSED(TS_SetAnalogueMoveExternal(REFERENCE_TORQUE, TRUE, 1, UPDATE_NONE), "LimitVariation");
    SENDS(TS_SetDigitalMoveExternal(TRUE, 2, 1, 0, UPDATE_NONE),
          "GEARMASTER = 2;\nGEARSLAVE = 1;\nGEAR = 0.5;\nEXTREF 2;\nMODE GS;\nTUM1;\n");
    SENDS(TS_SetOnlineMoveExternal(REFERENCE_POSITION, 0, 1000, UPDATE_NONE), "EREFP = 1000;\nEXTREF 0;\nMODE PE;\n");
    SENDS(TS_VoltageTestMode(100, 1, 0, 2, UPDATE_NONE),
          "REFTST_V = 100;\nRINCTST_V = 1;\nTHTST = 0;\nTINCTST = 2;\nMODE VT;\n");
    SENDS(TS_TorqueTestMode(100, 1, 0, 2, UPDATE_NONE),
          "REFTST_A = 100;\nRINCTST_A = 1;\nTHTST = 0;\nTINCTST = 2;\nMODE TT;\n");
    SENDS(TS_SetGearingMaster(FALSE, 2, FROM_REFERENCE, TRUE, FALSE, UPDATE_NONE),
          "SLAVEID = 2;\nSRBL OSR, 0xFFFF, 0x8000;\nSGM;\n");
    SENDS(TS_SetGearingMaster(TRUE, 1, FROM_MEASURE, TRUE, FALSE, UPDATE_NONE),
          "SLAVEID = 257;\nSRBL OSR, 0x7FFF, 0x0000;\nSGM;\n");
    SENDS(TS_SetGearingMaster(FALSE, 2, FROM_REFERENCE, FALSE, FALSE, UPDATE_IMMEDIATE), "RGM;\nUPD;\n");
    REFUSED(TS_SetGearingMaster(FALSE, 2, FROM_REFERENCE, TRUE, TRUE, UPDATE_NONE), "SetSlavePos");
    SENDS(TS_SetGearingSlave(1, -3, FROM_REFERENCE, SLAVE_COMMUNICATION_CHANNEL, 0, UPDATE_NONE),
          "GEARMASTER = 1;\nGEARSLAVE = -3;\nGEAR = -3;\nEXTREF 0;\nMODE GS;\nTUM1;\n");
    SENDS(TS_SetCammingMaster(FALSE, 2, FROM_MEASURE, TRUE, UPDATE_NONE),
          "SLAVEID = 2;\nSRBL OSR, 0x7FFF, 0x0000;\nSGM;\n");
    SENDS(TS_SetCammingSlaveRelative(0x9000, FROM_REFERENCE, SLAVE_2ND_ENCODER, UPDATE_NONE, 10, 0, 0.5),
          "CAMSTART = -28672;\nCAMOFF = 10;\nCAMY = 0.5;\nEXTREF 2;\nSRBL ACR, 0xEFFF, 0x0000;\nMODE CS;\nTUM1;\n");
    SENDS(TS_SetCammingSlaveAbsolute(0, 0, FROM_REFERENCE, SLAVE_COMMUNICATION_CHANNEL, UPDATE_NONE, 0, 0, 0),
          "EXTREF 0;\nSRBL ACR, 0xFFFF, 0x1000;\nMODE CS;\nTUM1;\n");
    SENDS(TS_MotionSuperposition(SUPERPOS_ENABLE, 0), "REG_ON;\n");
    SENDS(TS_MotionSuperposition(SUPERPOS_DISABLE, 0), "REG_OFF;\n");
    SENDS(TS_SetMasterResolution(4000), "MASTERRES = 4000;\n");
    SENDS(TS_SendSynchronization(0), "SETSYNC 0;\n");
    SENDS(TS_QuickStopDecelerationRate(0.75), "CDEC = 0.75;\n");
    SENDS(TS_UpdateOnEvent(), "UPD!;\n");
    SENDS(TS_SetCurrent(100), "IDRSTEP = 100;\n");
    TS_CloseChannel(-1);
}

static void test_paths(void)
{
    short count = 1;

    open_axes();
    power(1);
    SENDS(TS_PVTSetup(1, 1, 1, 0, 1, 1, 4), "SETPVT -23423;\n");
    SENDS(TS_SendPVTFirstPoint(100, 4, 50, count, RELATIVE_POSITION, 0, UPDATE_NONE, FROM_REFERENCE),
          "CPR;\nMODE PVT;\nTUM1;\nPVTP 100, 4, 50, 1;\n");
    while (++count < 6)
        EXPECT(TS_SendPVTPoint(200, 4, 50, count));
    EXPECT(TS_SendPVTPoint(100, 0, 50, count) && TS_UpdateImmediate());
    while (read_long("TPOS") != 1000)
        pause_ms(5);
    EXPECT(TS_SetEventOnMotionComplete(TRUE, FALSE) && TS_Stop());
    EXPECT(TS_PTSetup(1, 1, 1, 0, 0, 1, 0));
    EXPECT(TS_SendPTFirstPoint(100, 50, 1, RELATIVE_POSITION, 0, UPDATE_NONE, FROM_REFERENCE));
    EXPECT(TS_SendPTPoint(0, 50, 2) && TS_UpdateImmediate());
    while (read_long("TPOS") != 1100)
        pause_ms(5);
    REFUSED(TS_SendPVTPoint(1, 1, 1, 128), "0 to 127");
    EXPECT(TS_Stop() && TS_Power(POWER_OFF));
    TS_CloseChannel(-1);
}

static void test_programs(void)
{
    char path[512];
    WORD words[3] = { 0x1234, 0x5678, 0x9ABC }, read[3] = { 0, 0, 0 }, sum = 0, entry = 0;
    short word = 0;
    FILE *file;

    open_axes();
    EXPECT(TS_SelectAxis(1) && TS_DriveInitialisation());
    EXPECT(TS_SetBuffer(0x9000, words, 3) && TS_GetBuffer(0x9000, read, 3));
    EXPECT(memcmp(words, read, sizeof words) == 0);
    EXPECT(TS_OnlineChecksum(0x9000, 0x9002, &sum) && sum == (WORD)(0x1234 + 0x5678 + 0x9ABC));
    REFUSED(TS_SetBuffer(0x0228, words, 3), "data memory");
    REFUSED(TS_GetBuffer(0xFFFF, read, 3), "do not fit");
    REFUSED(TS_GetBuffer(0x9000, read, 0), "nSize");

    snprintf(path, sizeof path, "%s/routine.tml", folder);
    EXPECT((file = fopen(path, "w")) != NULL);
    fputs("VAR_I1 = 321;\nRET;\nother: VAR_I1 = 654;\nRET;\n", file);
    fclose(file);
    EXPECT(TS_DownloadProgram(path, &entry) && entry == 0x4000);
    EXPECT(TS_SetIntVariable("VAR_I1", 0) && TS_CancelableCALL(entry));
    while (word != 321)
        EXPECT(TS_GetIntVariable("VAR_I1", &word));
    EXPECT(TS_ABORT() && TS_CALL_Label("other"));
    while (word != 654)
        EXPECT(TS_GetIntVariable("VAR_I1", &word));
    EXPECT(TS_SetIntVariable("VAR_I1", 0) && TS_CancelableCALL_Label("Other"));
    for (word = 0; word != 654;)
        EXPECT(TS_GetIntVariable("VAR_I1", &word));
    EXPECT(TS_ABORT() && TS_SetIntVariable("VAR_I1", 0) && TS_GOTO_Label("other"));
    for (word = 0; word != 654;)
        EXPECT(TS_GetIntVariable("VAR_I1", &word));
    REFUSED(TS_CALL_Label("nowhere"), "no label");
    snprintf(path, sizeof path, "%s/script.txt", folder);
    EXPECT((file = fopen(path, "w")) != NULL);
    fputs("VAR_I1 = 1;\nVAR_I2 = 2;\n", file);
    fclose(file);
    EXPECT(TS_ExecuteScript(path) && TS_GetIntVariable("VAR_I2", &word) && word == 2);
    REFUSED(TS_ExecuteScript("not-there.txt"), "not-there.txt");
    REFUSED(TS_DownloadProgram("program.out", &entry), ".sw");
    TS_CloseChannel(-1);
}

static void test_logger(void)
{
    /* Position, the low word first, and the position error. */
    const WORD addresses[] = { 0x0228, 0x0229, 0x022A };
    WORD values[300], left = 0, count = 300, buffer = 0x8270;

    open_axes();
    EXPECT(TS_SelectAxis(2));
    REFUSED(TS_UploadLoggerResults(buffer, values, &count), "TS_SetupLogger first");
    REFUSED(TS_SetupLogger(buffer + 1, 400, addresses, 3, 1), "multiple of 8");
    REFUSED(TS_SetupLogger(buffer, 8, addresses, 3, 1), "too short");
    REFUSED(TS_SetupLogger(buffer, 400, addresses, 0, 1), "countAddr");
    /* Three words, three addresses, fifty points: this log would take half an hour. */
    EXPECT(TS_SetupLogger(buffer, 156, addresses, 3, 0x7FFF));
    EXPECT(TS_CheckLoggerStatus(buffer, &left) && left == 50);
    REFUSED(TS_StartLogger(buffer, 3), "LOGGER_SLOW");
    EXPECT(TS_StartLogger(buffer, LOGGER_SLOW));
    REFUSED(TS_SetupLogger(buffer, 156, addresses, 3, 1), "is running");
    EXPECT(TS_UploadLoggerResults(buffer, values, &count) && count == 0);
    EXPECT(TS_SetupLogger(buffer, 156, addresses, 3, 2) && TS_StartLogger(buffer, LOGGER_SLOW));
    while (left != 0)
        EXPECT(TS_CheckLoggerStatus(buffer, &left));
    count = 300;
    EXPECT(TS_UploadLoggerResults(buffer, values, &count) && count == 150);
    EXPECT((long)values[147] + 65536L * (short)values[148] == read_long("APOS"));
    count = 4;
    EXPECT(TS_UploadLoggerResults(buffer, values, &count) && count == 4);
    EXPECT(TS_SetupLogger(buffer, 156, addresses, 3, 1) && TS_StartLogger(buffer, LOGGER_FAST));
    for (left = 50; left != 0;)
        EXPECT(TS_CheckLoggerStatus(buffer, &left));
    TS_CloseChannel(-1);
}

static int messages;

static void handle_message(WORD axis, WORD address, long value)
{
    /* The low status word has bit 15 while the motor has power. */
    if (axis == 1 && (address == 0x090E || address == 0x090F))
        messages++;
    (void)value;
}

static void test_messages(void)
{
    open_device("sim:technosoft-f514l?through=1");
    EXPECT(TS_SelectAxis(1) && TS_DriveInitialisation());
    REFUSED(TS_CheckForUnrequestedDriveMessages(), "handler");
    TS_RegisterHandlerForUnrequestedDriveMessages(handle_message);
    EXPECT(TS_SendDataToHost(1, 0x00008000, 0));
    EXPECT(TS_Power(POWER_ON));
    while (messages == 0) {
        EXPECT(TS_CheckForUnrequestedDriveMessages());
        pause_ms(1);
    }
    EXPECT(TS_SendDataToHost(1, 0, 0) && TS_Power(POWER_OFF));
    TS_RegisterHandlerForUnrequestedDriveMessages(NULL);
    TS_CloseChannel(-1);
}

/* Each thread has its own axis. */
static void *count_on_axis(void *argument)
{
    BYTE axis = (BYTE)(long)argument;
    short word, n;

    EXPECT(TS_SelectAxis(axis));
    for (n = 1; n <= 200; n++) {
        EXPECT(TS_SetIntVariable("VAR_I1", (short)(n * axis)));
        EXPECT(TS_GetIntVariable("VAR_I1", &word) && word == n * axis);
    }
    return NULL;
}

static void *use_what_is_selected(void *argument)
{
    short word;

    (void)argument;
    EXPECT(TS_GetIntVariable("VAR_I1", &word));
    return NULL;
}

static void test_threads(void)
{
    pthread_t threads[2];
    int first = open_axes(), second = TS_OpenChannel(DRIVES, CHANNEL_RS232, 1, 115200);
    long n;

    /* A second channel to the same device is the same link. */
    EXPECT(second >= 0 && second != first);
    EXPECT(TS_SelectAxis(1));
    TS_CloseChannel(second);
    EXPECT(TS_SelectChannel(first));
    for (n = 0; n < 2; n++)
        EXPECT(pthread_create(&threads[n], NULL, count_on_axis, (void *)(n + 1)) == 0);
    for (n = 0; n < 2; n++)
        pthread_join(threads[n], NULL);
    EXPECT(TS_SelectAxis(2));
    EXPECT(pthread_create(&threads[0], NULL, use_what_is_selected, NULL) == 0);
    pthread_join(threads[0], NULL);
    TS_CloseChannel(first);
}

static void test_unsupported(void)
{
    WORD word;
    BYTE byte;
    double factor;
    int version;

    REFUSED(TS_CamDownload("a.cam", 1, 1, &word, &word), "not supported");
    REFUSED(TS_GetHomeInput(&byte), "not supported");
    REFUSED(TS_SetEventOnHomeInput(1, 0, 0), "not supported");
    REFUSED(TS_GetLoadPositionScalingFactor(&factor), "not supported");
    REFUSED(TS_GetTimeScalingFactor(&factor) || TS_GetFirmwareVersion(&version), "not supported");
}

int main(int count, char **arguments)
{
    /* What waits for ever is ended. */
    alarm(300);
    EXPECT(count == 3);
    setup = arguments[1];
    folder = arguments[2];
    test_what_comes_first();
    test_moves();
    test_variables();
    test_events_and_lines();
    test_modes();
    test_paths();
    test_programs();
    test_messages();
    test_threads();
    test_logger();
    test_unsupported();
    puts("functions work");
    return 0;
}
