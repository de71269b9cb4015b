/* bxCAN, the classic CAN controller of STM32F1, F2, F3, F4 and F7: what the port needs of it. */
#ifndef BXCAN_H
#define BXCAN_H

#include "../../hfp.h"

enum { BXCAN_QUEUE = 16 }; /* frames that wait for one of the three mailboxes, a power of two */

typedef struct {
    hfp_frame waiting[BXCAN_QUEUE];
    uint32_t head; /* counts of frames, never reset */
    uint32_t tail;
} bxcan;

/* Start at 1 Mbit/s from a 42 MHz clock, sample point 85.7 % (HFP-001, HFP-003). */
void bxcan_start(bxcan *can, uint8_t node);

/* Let pass data frames with 11-bit ids to this node and to all (HFP-002, HFP-012): two masks of one filter bank. */
void bxcan_filter(uint8_t node);

bool bxcan_receive(hfp_frame *frame);

/* Queue a frame; false: no room. `bxcan_pump` moves what waits into free mailboxes, in order. */
bool bxcan_send(bxcan *can, const hfp_frame *frame);
void bxcan_pump(bxcan *can);

#endif
