/*
 * A board for the bench under emulation: the reference firmware with converters as fine as the wire, and the gains of
 * configs/paper.yaml. Encoder: 2^24 counts a turn on TIM5, 32 bits. Current: 0.2 mA a step behind SPI2, 1 uA a step of
 * its reference behind SPI3. All else, and all object code below it, is that of port/stm32f4.
 */
#include "../../firmware_protocol/c/port/stm32f4/bxcan.h"

#define REG32(address) (*(volatile uint32_t *)(uintptr_t)(address))
#define TIM2_CNT REG32(0x40000024U)
#define TIM5_CNT REG32(0x40000C24U)
#define SPI2_DR REG32(0x4000380CU)
#define SPI3_DR REG32(0x40003C0CU)

enum { SAMPLE_US = 1000 };

static const float STEPS_PER_A = 1.0e6F;
static const hfp_loop_config LOOP = {1.0e-3F, 2.0F, 100.0F, 6.0e-3F, 150.0F, 1.0F, 0.0F};

typedef struct {
    hfp_node node;
    bxcan can;
    uint32_t next_sample_us;
} board;

static board self;

bool setup(void);
void turn(void);
int main(void);

static bool port_receive(void *context, hfp_frame *frame)
{
    (void)context;
    return bxcan_receive(frame);
}

static bool port_send(void *context, const hfp_frame *frame)
{
    return bxcan_send(&((board *)context)->can, frame);
}

static uint32_t port_now_us(void *context)
{
    (void)context;
    return TIM2_CNT;
}

static void port_measure(void *context, hfp_reading *reading)
{
    (void)context;
    reading->stamp_us = TIM2_CNT;
    reading->theta_m_raw = (int32_t)TIM5_CNT;
    reading->current_raw = (int16_t)SPI2_DR;
}

static hfp_fault port_protection(void *context)
{
    (void)context;
    return HFP_FAULT_NONE;
}

static void port_set_current(void *context, float current_A)
{
    (void)context;
    SPI3_DR = (uint32_t)(int32_t)(current_A * STEPS_PER_A);
}

static void port_keep_node(void *context, uint8_t node)
{
    (void)context;
    bxcan_filter(node);
}

static const hfp_port PORT = {
    port_receive, port_send, port_now_us, port_measure, port_protection, port_set_current, port_keep_node};

bool setup(void)
{
    hfp_config config = hfp_config_default(1, 0x00C0DE000002);

    bxcan_start(&self.can, config.node);
    self.next_sample_us = TIM2_CNT;
    return hfp_node_init(&self.node, &config, &LOOP, 1, &PORT, &self);
}

void turn(void)
{
    hfp_node_service(&self.node);
    bxcan_pump(&self.can);
    if (TIM2_CNT - self.next_sample_us < UINT32_MAX / 2) {
        self.next_sample_us += SAMPLE_US;
        hfp_node_sample(&self.node);
    }
}

int main(void)
{
    if (setup()) {
        for (;;) {
            turn();
        }
    }
    return 1;
}
