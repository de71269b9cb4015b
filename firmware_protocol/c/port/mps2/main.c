/*
 * The reference firmware on a Cortex-M4F under QEMU: `qemu-system-arm -M mps2-an386`, serial packets on UART0, the motor
 * and its clock in the image (test_plant.c) or outside on UART1 (outside_plant.c). One loop and no interrupt handler:
 * interrupts are masked, and a pending one does no more than end the sleep.
 */
#include "plant.h"
#include "uart.h"

#define REG32(address) (*(volatile uint32_t *)(uintptr_t)(address))
#define NVIC_ISER REG32(0xE000E100U)
#define NVIC_ICPR REG32(0xE000E280U)
#define SCB_ICSR REG32(0xE000ED04U)
#define UART0 ((uintptr_t)0x40004000U)

enum { SAMPLE_US = 1000, UART_INTERRUPTS = 0xF, PENDSTCLR = 1 << 25 }; /* receive and transmit of UART0 and UART1 */

static const hfp_loop_config LOOP = {1.0e-3F, 2.0F, 100.0F, 6.0e-3F, 150.0F, 1.0F, 0.0F}; /* of configs/paper.yaml */
static const uint64_t SERIAL_NUMBER = 0x00C0DE000386U;

typedef struct {
    hfp_node node;
    hfp_serial_reader reader;
    uart line;
    link_count count;
} board;

static board self;

int main(void);

static bool port_receive(void *context, hfp_frame *frame)
{
    board *b = context;
    uint8_t byte;

    while (uart_read(&b->line, &byte)) {
        if (hfp_serial_feed(&b->reader, byte, frame)) {
            b->count.taken++;
            return true;
        }
    }
    return false;
}

static bool port_send(void *context, const hfp_frame *frame)
{
    board *b = context;
    uint8_t packet[HFP_MAX_PACKET];

    if (!uart_write(&b->line, packet, hfp_serial_encode(frame, packet))) {
        return false;
    }
    b->count.sent++;
    return true;
}

static uint32_t port_now_us(void *context)
{
    (void)context;
    return plant_now_us();
}

static void port_measure(void *context, hfp_reading *reading)
{
    (void)context;
    plant_measure(reading);
}

static hfp_fault port_protection(void *context)
{
    (void)context;
    return HFP_FAULT_NONE; /* nothing here can break */
}

static void port_set_current(void *context, float current_A)
{
    (void)context;
    plant_set_current(current_A);
}

static void port_keep_node(void *context, uint8_t node)
{
    (void)context; /* an emulator forgets */
    (void)node;
}

static const hfp_port PORT = {
    port_receive, port_send, port_now_us, port_measure, port_protection, port_set_current, port_keep_node};

int main(void)
{
    hfp_config config = hfp_config_default(1, SERIAL_NUMBER);

    __asm volatile("cpsid i" ::: "memory");
    config.sample_period_us = SAMPLE_US * PLANT_FEEDBACK_DIVIDER;
    uart_start(&self.line, UART0);
    plant_start();
    NVIC_ISER = UART_INTERRUPTS;
    if (!hfp_serial_init(&self.reader, HFP_MAX_PAYLOAD) ||
        !hfp_node_init(&self.node, &config, &LOOP, PLANT_FEEDBACK_DIVIDER, &PORT, &self)) {
        return 1; /* a setting is out of its bounds: the motor stays without current */
    }
    for (;;) {
        NVIC_ICPR = UART_INTERRUPTS; /* before the work: what comes after it ends the sleep */
        SCB_ICSR = PENDSTCLR;
        bool worked = plant_turn(&self.node, &self.count);
        if (!uart_pump(&self.line) && !worked) {
            __asm volatile("wfi");
        }
    }
}
