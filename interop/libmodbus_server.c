/* A Modbus TCP server of libmodbus with 100 registers that hold their own number, for one client.
   libmodbus_server prints its port, and ends with its client. */
#include <arpa/inet.h>
#include <modbus.h>
#include <stdio.h>
#include <sys/socket.h>
#include <unistd.h>

int main(void)
{
    struct sockaddr_in address = {0};
    socklen_t len = sizeof address;
    modbus_t *server = modbus_new_tcp("127.0.0.1", 0);
    modbus_mapping_t *map = modbus_mapping_new(8, 8, 100, 100);
    int listener = socket(AF_INET, SOCK_STREAM, 0);
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (!server || !map || bind(listener, (struct sockaddr *)&address, len) || listen(listener, 1))
        return 1;
    getsockname(listener, (struct sockaddr *)&address, &len);
    for (int n = 0; n < 100; n++)
        map->tab_registers[n] = (uint16_t)n;
    printf("%d\n", ntohs(address.sin_port));
    fflush(stdout);
    if (modbus_tcp_accept(server, &listener) < 0)
        return 1;
    for (;;) {
        uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
        int got = modbus_receive(server, query);
        if (got < 0)
            break;
        if (got > 0)
            modbus_reply(server, query, got, map);
    }
    modbus_mapping_free(map);
    modbus_free(server);
    close(listener);
    return 0;
}
