/* CMSDK APB UART: a register for one byte each way, rings behind it. */
#ifndef UART_H
#define UART_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { UART_RING = 1024 }; /* bytes, a power of two */

typedef struct {
    uint8_t bytes[UART_RING];
    uint32_t in; /* ever put in */
    uint32_t out; /* ever taken out */
} uart_ring;

typedef struct {
    uintptr_t base;
    uart_ring received;
    uart_ring to_send;
} uart;

void uart_start(uart *port, uintptr_t base);

/* Move bytes between registers and rings, as many as there are; true when there were any. */
bool uart_pump(uart *port);

bool uart_read(uart *port, uint8_t *byte);

/* Queue all of it or, where there is no room, nothing. */
bool uart_write(uart *port, const uint8_t *data, size_t length);

#endif
