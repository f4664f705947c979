/* Reads many registers with libmodbus as it comes, from a drive that misbehaves once.
   libmodbus_reads PORT N TIMEOUT_MS prints: right R wrong W failed F */
#include <modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

static const int numbers[] = {1, 4, 5, 7, 9, 11};

int main(int count, char **words)
{
    int right = 0, wrong = 0, failed = 0;
    uint32_t seed = 1;
    if (count != 4)
        return 2;
    modbus_t *drive = modbus_new_rtu(words[1], 115200, 'N', 8, 1);
    if (!drive || modbus_set_slave(drive, 1) || modbus_connect(drive))
        return 1;
    modbus_set_response_timeout(drive, 0, (uint32_t)atoi(words[3]) * 1000);
    for (int n = 0; n < atoi(words[2]); n++) {
        uint16_t word = 0;
        seed = seed * 1664525u + 1013904223u;
        int number = numbers[(seed >> 16) % 6];
        usleep(2000);
        if (modbus_read_registers(drive, number, 1, &word) != 1)
            failed++;
        else if (word == number)
            right++;
        else
            wrong++;
    }
    printf("right %d wrong %d failed %d\n", right, wrong, failed);
    modbus_free(drive);
    return 0;
}
