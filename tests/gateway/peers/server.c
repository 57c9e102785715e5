// SPDX-FileCopyrightText: 2026 The ros2_deepc authors
// SPDX-License-Identifier: Apache-2.0
//
// A Modbus/TCP device made with libmodbus: two floats and a counter to read, and whatever is written is copied from
// holding register i to input register 20 + i.
#include <modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// The high word first, or second if swapped. modbus_set_float_abcd() of libmodbus 3.1.6 swaps the bytes of each word.
static void put(float value, uint16_t *registers, int swapped) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    registers[swapped] = (uint16_t)(bits >> 16);
    registers[!swapped] = (uint16_t)bits;
}

int main(int argc, char **argv) {
    modbus_t *device = modbus_new_tcp("127.0.0.1", atoi(argv[argc - 1]));
    modbus_mapping_t *map = modbus_mapping_new(0, 0, 20, 40);
    int listener = modbus_tcp_listen(device, 1);
    uint8_t request[MODBUS_TCP_MAX_ADU_LENGTH];
    if (listener < 0) return 1;
    put(3.25f, map->tab_input_registers + 2, 0);
    put(-1e-3f, map->tab_input_registers + 4, 1);
    printf("ready\n");
    fflush(stdout);
    for (;;) {
        if (modbus_tcp_accept(device, &listener) < 0) return 1;
        for (int length; (length = modbus_receive(device, request)) >= 0;) {
            if (length == 0) continue;
            map->tab_input_registers[0]++;
            modbus_reply(device, request, length, map);
            memcpy(map->tab_input_registers + 20, map->tab_registers, 20 * sizeof(uint16_t));
        }
        modbus_close(device);
    }
}
