/*
 * Example: the reference firmware on an STM32F405 with a quadrature encoder of 4096 lines on TIM3, a current amplifier
 * behind DAC channel 1 and its monitor on ADC1. Clocks and pins are the board's own and not set here.
 */
#include "bxcan.h"

#define REG32(address) (*(volatile uint32_t *)(uintptr_t)(address))
#define TIM2_CNT REG32(0x40000024U) /* 32 bits, 1 MHz, free-running: the clock of the stamps */
#define TIM3_CNT REG32(0x40000424U) /* 16 bits, encoder mode, four counts a line */
#define DAC_DHR12R1 REG32(0x40007408U)
#define ADC1_JDR1 REG32(0x4001203CU)
#define FLASH_NODE (*(const volatile uint8_t *)(uintptr_t)0x080E0000U) /* a sector of its own; 0xFF when empty */

enum { COUNTS_PER_REV = 16384, RAW_PER_COUNT = (1 << 24) / COUNTS_PER_REV, SAMPLE_US = 1000 };
enum { MID_SCALE = 2048, FULL_SCALE = 4095, RAW_PER_ADC = 5 }; /* 1 mA a step of the ADC, 0.2 mA on the wire */

static const float STEPS_PER_A = 1000.0F;
static const hfp_loop_config LOOP = {1.0e-3F, 1.2F, 15.0F, 6.0e-3F, 150.0F, 1.0F, 0.0F};

typedef struct {
    hfp_node node;
    bxcan can;
    int32_t theta_m_raw;
    uint16_t count; /* of the encoder at the last measurement */
    uint32_t next_sample_us;
} board;

static board self; /* the only variable of the image */

/* Apart, so that an emulator can call them. */
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
    board *b = context;
    uint16_t count = (uint16_t)TIM3_CNT;

    reading->stamp_us = TIM2_CNT;
    b->theta_m_raw = (int32_t)((uint32_t)b->theta_m_raw + (uint32_t)((int16_t)(count - b->count) * RAW_PER_COUNT));
    b->count = count;
    reading->theta_m_raw = b->theta_m_raw;
    reading->current_raw = ((int32_t)(ADC1_JDR1 & FULL_SCALE) - MID_SCALE) * RAW_PER_ADC;
}

static hfp_fault port_protection(void *context)
{
    (void)context;
    return HFP_FAULT_NONE; /* read the amplifier's fault pin, the supply and the temperature here */
}

static void port_set_current(void *context, float current_A)
{
    int32_t steps = MID_SCALE + (int32_t)(current_A * STEPS_PER_A);

    (void)context;
    DAC_DHR12R1 = (uint32_t)(steps < 0 ? 0 : steps > FULL_SCALE ? FULL_SCALE : steps);
}

static void port_keep_node(void *context, uint8_t node)
{
    (void)context;
    bxcan_filter(node); /* and write it to FLASH_NODE, outside the sampling */
}

static const hfp_port PORT = {
    port_receive, port_send, port_now_us, port_measure, port_protection, port_set_current, port_keep_node};

bool setup(void)
{
    uint8_t node = FLASH_NODE;
    hfp_config config = hfp_config_default(node >= 1 && node <= HFP_MAX_NODE ? node : 1, 0x00C0DE000001);

    config.counts_per_rev = COUNTS_PER_REV;
    self.count = (uint16_t)TIM3_CNT;
    bxcan_start(&self.can, config.node);
    self.next_sample_us = TIM2_CNT;
    return hfp_node_init(&self.node, &config, &LOOP, 1, &PORT, &self);
}

/* One turn of the main loop. Where its jitter is too much: the sample in a timer interrupt, the rest at the same level. */
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
    return 1; /* a setting is out of its bounds: the motor stays without current */
}
