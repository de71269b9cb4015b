/* TEST PLANT: J w' = Kt i - D w, moved exactly under constant current. Not the forceps: no wire, no jaw, no load. */
#include "host.h"

#include <math.h>

static const double TIME_CONSTANT_S = 2.74e-4; /* J / D of the paper's motor */
static const double SPEED_PER_A = 116.4; /* Kt / D, rad/s */
static const double RAW_PER_RAD = 16777216.0 / 6.283185307179586;

void test_plant_move(test_plant *plant, double current_A, double duration_s)
{
    double settled = SPEED_PER_A * current_A;
    double left = exp(-duration_s / TIME_CONSTANT_S);
    double away = plant->speed_rad_per_s - settled;

    plant->theta_rad += settled * duration_s + away * TIME_CONSTANT_S * (1.0 - left);
    plant->speed_rad_per_s = settled + away * left;
}

int32_t test_plant_theta_raw(const test_plant *plant)
{
    return (int32_t)(uint32_t)llround(plant->theta_rad * RAW_PER_RAD);
}
