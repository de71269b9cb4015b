#include "uart.h"

#define REG32(address) (*(volatile uint32_t *)(address))

enum { DATA = 0x00, STATE = 0x04, CTRL = 0x08, INT_CLEAR = 0x0C, BAUD_DIVIDER = 0x10 };
enum { STATE_TX_FULL = 1, STATE_RX_FULL = 2, CTRL_ON = 0x3, CTRL_RX_INTERRUPT = 0x8, INT_ALL = 0xF };
enum { LEAST_DIVIDER = 16 };

void uart_start(uart *port, uintptr_t base)
{
    *port = (uart){.base = base};
    REG32(base + BAUD_DIVIDER) = LEAST_DIVIDER;
    REG32(base + CTRL) = CTRL_ON | CTRL_RX_INTERRUPT;
}

bool uart_pump(uart *port)
{
    uart_ring *received = &port->received;
    uart_ring *to_send = &port->to_send;
    bool moved = false;

    REG32(port->base + INT_CLEAR) = INT_ALL; /* before the look: what comes after it interrupts again */
    while (received->in - received->out < UART_RING && (REG32(port->base + STATE) & STATE_RX_FULL) != 0) {
        received->bytes[received->in++ % UART_RING] = (uint8_t)REG32(port->base + DATA);
        moved = true;
    }
    while (to_send->in != to_send->out && (REG32(port->base + STATE) & STATE_TX_FULL) == 0) {
        REG32(port->base + DATA) = to_send->bytes[to_send->out++ % UART_RING];
        moved = true;
    }
    return moved;
}

bool uart_read(uart *port, uint8_t *byte)
{
    uart_ring *received = &port->received;

    if (received->in == received->out) {
        return false;
    }
    *byte = received->bytes[received->out++ % UART_RING];
    return true;
}

bool uart_write(uart *port, const uint8_t *data, size_t length)
{
    uart_ring *to_send = &port->to_send;

    if (length > UART_RING - (to_send->in - to_send->out)) {
        return false;
    }
    for (size_t i = 0; i < length; i++) {
        to_send->bytes[to_send->in++ % UART_RING] = data[i];
    }
    return true;
}
