/*
 * TEST PLANT, inside the image and in real time: J w' = Kt i - D w, moved exactly under constant current. Not the
 * forceps: no wire, no jaw, no load. Samples are due each millisecond of FPGAIO's counter, which latches them.
 */
#include "plant.h"

#define REG32(address) (*(volatile uint32_t *)(uintptr_t)(address))
#define COUNTER REG32(0x40028018U) /* 25 MHz, free-running: a counted SysTick would lose time */
#define SYST_CSR REG32(0xE000E010U)
#define SYST_RVR REG32(0xE000E014U)
#define SYST_CVR REG32(0xE000E018U)

enum { COUNTS_PER_US = 25, SAMPLE_US = 1000, MAX_LATE_US = 10000, WAKE_COUNTS = 12500, SYST_ON = 7 };

const uint16_t PLANT_FEEDBACK_DIVIDER = 2; /* in real time the emulated UART has some 100 kB/s, and a host core for them */

static const float PERIOD_S = 1.0e-3F;
static const float TIME_CONSTANT_S = 2.74e-4F; /* J / D of the paper's motor */
static const float SPEED_PER_A = 116.4F; /* Kt / D, rad/s */
static const float LEFT = 2.59966e-2F; /* e^-(1 ms / time constant) */
static const float RAW_PER_RAD = 2670176.9F; /* 2^24 / 2 pi */
static const float CURRENT_LSB_A = 2.0e-4F;

static struct {
    uint32_t counted; /* counts that are in now_us */
    uint32_t now_us;
    uint32_t due_us;
    float current_A;
    float speed_rad_per_s;
    int32_t theta_raw;
    float theta_rest_raw; /* less than one unit */
} self;

void plant_start(void)
{
    self.counted = COUNTER;
    SYST_RVR = WAKE_COUNTS - 1; /* wakes the processor, counts nothing */
    SYST_CVR = 0;
    SYST_CSR = SYST_ON;
}

uint32_t plant_now_us(void)
{
    uint32_t passed_us = (COUNTER - self.counted) / COUNTS_PER_US;

    self.counted += passed_us * COUNTS_PER_US;
    self.now_us += passed_us;
    return self.now_us;
}

void plant_measure(hfp_reading *reading)
{
    float settled = SPEED_PER_A * self.current_A;
    float away = self.speed_rad_per_s - settled;
    float moved_raw = (settled * PERIOD_S + away * TIME_CONSTANT_S * (1 - LEFT)) * RAW_PER_RAD + self.theta_rest_raw;
    int32_t whole = (int32_t)moved_raw;

    self.speed_rad_per_s = settled + away * LEFT;
    self.theta_rest_raw = moved_raw - (float)whole;
    self.theta_raw = (int32_t)((uint32_t)self.theta_raw + (uint32_t)whole);
    reading->stamp_us = self.due_us;
    reading->theta_m_raw = self.theta_raw;
    reading->current_raw = (int32_t)(self.current_A / CURRENT_LSB_A);
}

void plant_set_current(float current_A)
{
    self.current_A = current_A;
}

bool plant_turn(hfp_node *node, const link_count *link)
{
    uint32_t late_us = plant_now_us() - self.due_us;

    (void)link;
    hfp_node_service(node);
    if (late_us > UINT32_MAX / 2) {
        return false;
    }
    if (late_us > MAX_LATE_US) {
        self.due_us += late_us / SAMPLE_US * SAMPLE_US;
    }
    hfp_node_sample(node);
    self.due_us += SAMPLE_US;
    return true;
}
