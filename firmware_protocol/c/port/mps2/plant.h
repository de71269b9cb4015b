/* What is on the motor's shaft, and the clock that goes with it. An image has one of test_plant.c, outside_plant.c. */
#ifndef PLANT_H
#define PLANT_H

#include "../../hfp.h"

/* Frames on the link since power-up, modulo 256. */
typedef struct {
    uint8_t taken;
    uint8_t sent;
} link_count;

/* Every how manieth sample is sent: as many as the line to this plant's host carries. */
extern const uint16_t PLANT_FEEDBACK_DIVIDER;

void plant_start(void);
uint32_t plant_now_us(void);
void plant_measure(hfp_reading *reading);
void plant_set_current(float current_A);

/* Do what is due with the node, if anything; true when there was something. */
bool plant_turn(hfp_node *node, const link_count *link);

#endif
