// The header in C++: results are references, and some arguments have defaults.
#include <TML_lib.h>

#include <iostream>

int main(int, char **arguments)
{
    int channel = TS_OpenChannel("sim:technosoft-f514l?through=1", CHANNEL_RS232, 1, 115200);
    int setup = TS_LoadSetup(arguments[1]);
    if (channel < 0 || !TS_SetupAxis(1, setup) || !TS_SelectAxis(1) || !TS_DriveInitialisation() || !TS_Power(POWER_ON)) {
        std::cerr << TS_GetLastErrorText() << '\n';
        return 1;
    }
    WORD status = 0;
    while (!(status & 1 << 15))
        TS_ReadStatus(REG_SRL, status);
    long position = 0;
    if (!TS_MoveAbsolute(1500, 20, 0.5, UPDATE_IMMEDIATE, FROM_REFERENCE) || !TS_SetEventOnMotionComplete(TRUE, FALSE)
        || !TS_GetLongVariable("TPOS", position)) {
        std::cerr << TS_GetLastErrorText() << '\n';
        return 1;
    }
    TS_Stop();
    TS_Power(POWER_OFF);
    TS_CloseChannel();
    std::cout << "at " << position << '\n';
}
