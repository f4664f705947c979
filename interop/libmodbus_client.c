/* libmodbus against our Syntron TS: registers, a speed run, every exception it can provoke. */
#include <errno.h>
#include <modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

static modbus_t *drive;

static void must(int ok, const char *what)
{
    if (ok)
        return;
    printf("failed: %s: %s\n", what, modbus_strerror(errno));
    exit(1);
}

static uint16_t read1(int address)
{
    uint16_t word = 0;
    must(modbus_read_registers(drive, address, 1, &word) == 1, "read");
    return word;
}

static void settles_at(int rpm)
{
    for (int i = 0; i < 500; i++) {
        int16_t speed = (int16_t)read1(0x1000);
        if (abs(speed - rpm) <= 3)
            return;
        usleep(10000);
    }
    must(0, "speed");
}

int main(int count, char **words)
{
    uint16_t words8[8];
    uint16_t path[8] = {1002, 36, 0, 600, 100, 100, 0, 0};
    must(count == 2 || count == 3, "usage: libmodbus_client PORT | HOST TCP_PORT");
    if (count == 3)
        drive = modbus_new_tcp(words[1], atoi(words[2]));
    else
        drive = modbus_new_rtu(words[1], 115200, 'N', 8, 1);
    must(drive && modbus_set_slave(drive, 1) == 0 && modbus_connect(drive) == 0, "connect");
    must(read1(0x00) == 2, "factory mode");
    must(modbus_write_register(drive, 0x00, 1) == 1, "Fn_00 = 1");
    must(modbus_write_register(drive, 0x99, 1) == 1, "Fn_99 = 1");
    must(modbus_write_register(drive, 0x33, 300) == 1, "Fn_33 = 300");
    must(modbus_write_register(drive, 0x38, 1) == 1, "Fn_38 = 1");
    settles_at(300);
    must(modbus_write_register(drive, 0x38, 0) == 1, "Fn_38 = 0");
    settles_at(0);
    must(modbus_write_registers(drive, 0x100, 8, path) == 8, "path");
    must(modbus_read_registers(drive, 0x100, 8, words8) == 8, "path back");
    for (int i = 0; i < 8; i++)
        must(words8[i] == path[i], "path as written");
    must(modbus_read_input_registers(drive, 0, 1, words8) == -1 && errno == EMBXILFUN, "01");
    must(modbus_read_registers(drive, 0x300, 1, words8) == -1 && errno == EMBXILADD, "02");
    must(modbus_write_register(drive, 0x00, 999) == -1 && errno == EMBXILVAL, "03");
    must(read1(0x00) == 1, "in step after the exceptions");
    modbus_close(drive);
    modbus_free(drive);
    printf("all as expected\n");
    return 0;
}
