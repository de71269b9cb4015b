/*
 * The plant outside, on the second UART, is the only clock: requests and answers as host/lockstep.c says, one after the
 * other without anything between. A run is the same each time, however fast the emulator is.
 */
#include "plant.h"
#include "uart.h"

#include <string.h>

#define UART1 ((uintptr_t)0x40005000U)

enum { REQUEST_BYTES = 16, ANSWER_BYTES = 8, WHAT_SAMPLE = 1, WHAT_FRAMES = 2, FRAMES_SHIFT = 8 };

const uint16_t PLANT_FEEDBACK_DIVIDER = 1; /* nothing is in a hurry */

static struct {
    uart line;
    uint8_t request[REQUEST_BYTES];
    unsigned filled;
    uint32_t what;
    hfp_reading reading;
    float current_A;
} self;

static uint32_t load32(const uint8_t *data)
{
    return (uint32_t)data[0] | (uint32_t)data[1] << 8 | (uint32_t)data[2] << 16 | (uint32_t)data[3] << 24;
}

void plant_start(void)
{
    uart_start(&self.line, UART1);
}

uint32_t plant_now_us(void)
{
    return self.reading.stamp_us;
}

void plant_measure(hfp_reading *reading)
{
    *reading = self.reading;
}

void plant_set_current(float current_A)
{
    self.current_A = current_A;
}

static void answer(const hfp_node *node, uint8_t sent)
{
    uint32_t bits;
    uint8_t data[ANSWER_BYTES];

    memcpy(&bits, &self.current_A, sizeof bits);
    for (unsigned i = 0; i < sizeof bits; i++) {
        data[i] = (uint8_t)(bits >> 8 * i);
    }
    data[4] = node->drive.state;
    data[5] = node->drive.fault;
    data[6] = node->drive.node;
    data[7] = sent;
    (void)uart_write(&self.line, data, sizeof data); /* one answer at a time: there is room */
}

/* True when a request is there, and then its plant is what is measured. */
static bool is_asked(void)
{
    if (self.filled == REQUEST_BYTES) {
        return true;
    }
    while (self.filled < REQUEST_BYTES && uart_read(&self.line, &self.request[self.filled])) {
        self.filled++;
    }
    if (self.filled < REQUEST_BYTES) {
        return false;
    }
    self.reading.stamp_us = load32(self.request);
    self.reading.theta_m_raw = (int32_t)load32(&self.request[4]);
    self.reading.current_raw = (int32_t)load32(&self.request[8]);
    self.what = load32(&self.request[12]);
    return true;
}

bool plant_turn(hfp_node *node, const link_count *link)
{
    bool moved = uart_pump(&self.line);

    if (!is_asked()) {
        return moved;
    }
    hfp_node_service(node);
    if ((self.what & WHAT_FRAMES) != 0 && (uint8_t)(self.what >> FRAMES_SHIFT) != link->taken) {
        return moved; /* its bytes are still to come */
    }
    if ((self.what & WHAT_SAMPLE) != 0) {
        hfp_node_sample(node);
    }
    answer(node, link->sent);
    self.filled = 0;
    return true;
}
