#include "bxcan.h"

#define REG(offset) (*(volatile uint32_t *)(uintptr_t)(0x40006400U + (offset)))

enum {
    MCR = 0x000,
    MSR = 0x004,
    TSR = 0x008,
    RF0R = 0x00C,
    BTR = 0x01C,
    TI0R = 0x180,
    TDT0R = 0x184,
    TDL0R = 0x188,
    TDH0R = 0x18C,
    MAILBOX = 0x010, /* from one to the next */
    RI0R = 0x1B0,
    RDT0R = 0x1B4,
    RDL0R = 0x1B8,
    RDH0R = 0x1BC,
    FMR = 0x200,
    FM1R = 0x204,
    FS1R = 0x20C,
    FFA1R = 0x214,
    FA1R = 0x21C,
    F0R1 = 0x240,
    F0R2 = 0x244
};

enum { INRQ = 1, INAK = 1, TXFP = 1 << 2, ABOM = 1 << 6, FMP0 = 3, RFOM0 = 1 << 5, TXRQ = 1, TME = 7 << 26 };
enum { ID_SHIFT = 21, FILTER_SHIFT = 5, FILTER_NODE = 0x1F << 5, FILTER_RTR_IDE = 3 << 3 };

static uint32_t load32(const uint8_t *data)
{
    return (uint32_t)data[0] | (uint32_t)data[1] << 8 | (uint32_t)data[2] << 16 | (uint32_t)data[3] << 24;
}

static void store32(uint8_t *data, uint32_t value)
{
    for (unsigned i = 0; i < 4; i++) {
        data[i] = (uint8_t)(value >> 8 * i);
    }
}

void bxcan_start(bxcan *can, uint8_t node)
{
    can->head = can->tail = 0;
    REG(MCR) = INRQ;
    while ((REG(MSR) & INAK) == 0) {
    }
    REG(MCR) = INRQ | TXFP | ABOM; /* mailboxes in order of request; back after bus-off by itself */
    REG(BTR) = 0U << 24 | 1U << 20 | 10U << 16 | 2U; /* 42 MHz / 3 / (1 + 11 + 2) */
    bxcan_filter(node);
    REG(MCR) = TXFP | ABOM;
    while ((REG(MSR) & INAK) != 0) {
    }
}

void bxcan_filter(uint8_t node)
{
    uint32_t mask = FILTER_NODE | FILTER_RTR_IDE;

    REG(FMR) |= 1U;
    REG(FA1R) &= ~1U;
    REG(FM1R) &= ~1U; /* masks */
    REG(FS1R) &= ~1U; /* of 16 bits, two a bank */
    REG(FFA1R) &= ~1U;
    REG(F0R1) = mask << 16 | (uint32_t)node << FILTER_SHIFT;
    REG(F0R2) = mask << 16; /* node 0 */
    REG(FA1R) |= 1U;
    REG(FMR) &= ~1U;
}

bool bxcan_receive(hfp_frame *frame)
{
    if ((REG(RF0R) & FMP0) == 0) {
        return false;
    }
    uint32_t length = REG(RDT0R) & 15U;
    frame->id = (uint16_t)(REG(RI0R) >> ID_SHIFT);
    frame->is_fd = false;
    frame->length = (uint8_t)(length < HFP_MAX_CLASSIC_PAYLOAD ? length : HFP_MAX_CLASSIC_PAYLOAD);
    store32(&frame->data[0], REG(RDL0R));
    store32(&frame->data[4], REG(RDH0R));
    REG(RF0R) = RFOM0;
    return true;
}

bool bxcan_send(bxcan *can, const hfp_frame *frame)
{
    if (can->tail - can->head >= BXCAN_QUEUE) {
        return false;
    }
    can->waiting[can->tail++ % BXCAN_QUEUE] = *frame;
    bxcan_pump(can);
    return true;
}

void bxcan_pump(bxcan *can)
{
    while (can->head != can->tail && (REG(TSR) & TME) != 0) {
        const hfp_frame *frame = &can->waiting[can->head++ % BXCAN_QUEUE];
        uint32_t box = MAILBOX * (REG(TSR) >> 24 & 3U); /* CODE: a free one */
        REG(TDT0R + box) = frame->length;
        REG(TDL0R + box) = load32(&frame->data[0]);
        REG(TDH0R + box) = load32(&frame->data[4]);
        REG(TI0R + box) = (uint32_t)frame->id << ID_SHIFT | TXRQ;
    }
}
