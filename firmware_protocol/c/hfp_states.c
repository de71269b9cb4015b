/*
 * The states of the drive as a table, and which delay or reference is which event. The same machine is
 * firmware_protocol/drive/machine.py with states.py, and tests compare the two.
 */
#include "hfp_private.h"

enum {
    MAX_STEP_FACTOR = 8, /* steps that lost setpoints may add to the step limit */
    ALL_CONTROLS = 0xFF /* taken as high until a host has shown them low: a drive that restarts stays put */
};

/* States are stored plus one, so what is not in the table is nought and changes nothing. */
#define TO(state) ((uint8_t)((state) + 1))

static const uint8_t TRANSITIONS[HFP_STATES][EVENTS] = {
    [HFP_DISABLED] =
        {
            [ON_ENABLE] = TO(HFP_ARMED),
            [ON_VERSION_MISFIT] = TO(HFP_FAULT),
            [ON_ESTOP] = TO(HFP_FAULT),
            [ON_TRIP] = TO(HFP_FAULT),
        },
    [HFP_ARMED] =
        {
            [ON_DISABLE] = TO(HFP_DISABLED),
            [ON_REFERENCE] = TO(HFP_OPERATIONAL),
            [ON_REFERENCE_OFF] = TO(HFP_FAULT),
            [ON_REFERENCE_OUTSIDE] = TO(HFP_FAULT),
            [ON_ARM_EXPIRED] = TO(HFP_FAULT),
            [ON_HOST_LOST] = TO(HFP_FAULT),
            [ON_VERSION_MISFIT] = TO(HFP_FAULT),
            [ON_ESTOP] = TO(HFP_FAULT),
            [ON_TRIP] = TO(HFP_FAULT),
        },
    [HFP_OPERATIONAL] =
        {
            [ON_DISABLE] = TO(HFP_DISABLED),
            [ON_REFERENCE_OUTSIDE] = TO(HFP_FAULT),
            [ON_REFERENCE_JUMP] = TO(HFP_FAULT),
            [ON_WATCHDOG_EXPIRED] = TO(HFP_FAULT),
            [ON_HOST_LOST] = TO(HFP_FAULT),
            [ON_VERSION_MISFIT] = TO(HFP_FAULT),
            [ON_ESTOP] = TO(HFP_FAULT),
            [ON_TRIP] = TO(HFP_FAULT),
        },
    [HFP_FAULT] = {[ON_RESET] = TO(HFP_DISABLED)},
};

/* Why an event that faults does so; a trip brings its own reason. */
static const uint8_t REASONS[EVENTS] = {
    [ON_VERSION_MISFIT] = HFP_FAULT_VERSION,
    [ON_REFERENCE_OFF] = HFP_FAULT_REFERENCE_MISMATCH,
    [ON_REFERENCE_OUTSIDE] = HFP_FAULT_REFERENCE_POSITION,
    [ON_REFERENCE_JUMP] = HFP_FAULT_REFERENCE_RATE,
    [ON_WATCHDOG_EXPIRED] = HFP_FAULT_WATCHDOG,
    [ON_HOST_LOST] = HFP_FAULT_HOST_HEARTBEAT_LOST,
    [ON_ARM_EXPIRED] = HFP_FAULT_ENABLE_TIMEOUT,
    [ON_ESTOP] = HFP_FAULT_ESTOP,
};

void hfp_fire_for(hfp_drive *drive, hfp_event what, uint8_t reason)
{
    uint8_t to = TRANSITIONS[drive->state][what];

    if (to == 0) {
        return;
    }
    drive->state = (uint8_t)(to - 1);
    drive->announce = true;
    drive->fault = HFP_FAULT_NONE;
    if (drive->state == HFP_FAULT) {
        drive->fault = reason;
        drive->counters[HFP_COUNT_FAULTS]++;
    }
    drive->has_reference = drive->state == HFP_OPERATIONAL;
}

void hfp_fire(hfp_drive *drive, hfp_event what)
{
    hfp_fire_for(drive, what, REASONS[what]);
}

void hfp_forget_host(hfp_drive *drive)
{
    drive->host_present = false;
    drive->levels = ALL_CONTROLS;
}

bool hfp_has_passed(uint32_t since_us, uint32_t now_us, int32_t timeout_us)
{
    return now_us - since_us >= (uint32_t)timeout_us;
}

void hfp_expire(hfp_drive *drive, uint32_t now_us)
{
    const int32_t *values = drive->values;

    if (drive->state == HFP_OPERATIONAL && hfp_has_passed(drive->fed_us, now_us, values[HFP_ROW_WATCHDOG_TIMEOUT])) {
        hfp_fire(drive, ON_WATCHDOG_EXPIRED);
    } else if (drive->state == HFP_ARMED && hfp_has_passed(drive->armed_us, now_us, values[HFP_ROW_ARM_TIMEOUT])) {
        hfp_fire(drive, ON_ARM_EXPIRED);
    }
    if (drive->host_present && hfp_has_passed(drive->host_us, now_us, values[HFP_ROW_HOST_HEARTBEAT_TIMEOUT])) {
        hfp_forget_host(drive);
        hfp_fire(drive, ON_HOST_LOST);
    }
}

/* ---- references -------------------------------------------------------------------------------------------------- */

/* Distance of two angles modulo 2^32. */
static uint32_t distance(int32_t a, int32_t b)
{
    uint32_t forward = (uint32_t)a - (uint32_t)b;
    uint32_t backward = (uint32_t)b - (uint32_t)a;

    return forward < backward ? forward : backward;
}

uint8_t hfp_drop(hfp_drive *drive, hfp_counter reason)
{
    drive->counters[reason]++;
    return 0;
}

/* By how much the sequence advanced (1 for the first of a session); 0 when not fresh or not wanted, and counted. */
static uint8_t freshness(hfp_drive *drive, const hfp_reference *reference)
{
    uint8_t age = (uint8_t)(drive->sequence - reference->sample_sequence);
    uint8_t advance = (uint8_t)(reference->sequence - drive->setpoint_sequence);

    if (drive->state != HFP_ARMED && drive->state != HFP_OPERATIONAL) {
        return hfp_drop(drive, HFP_COUNT_NOT_ENABLED);
    }
    if (!drive->has_sample || age > HFP_MAX_ADVANCE) {
        return hfp_drop(drive, HFP_COUNT_SAMPLE_FUTURE);
    }
    if (age > drive->values[HFP_ROW_MAX_SAMPLE_AGE]) {
        return hfp_drop(drive, HFP_COUNT_SAMPLE_OLD);
    }
    if (drive->state == HFP_ARMED) {
        return 1;
    }
    return advance >= 1 && advance <= HFP_MAX_ADVANCE ? advance : hfp_drop(drive, HFP_COUNT_SETPOINT_STALE);
}

static hfp_event judge_reference(const hfp_drive *drive, int32_t reference, uint8_t advance, int32_t theta_m_raw)
{
    const int32_t *values = drive->values;
    uint32_t steps = advance < MAX_STEP_FACTOR ? advance : MAX_STEP_FACTOR;

    if (reference < values[HFP_ROW_THETA_MIN] || reference > values[HFP_ROW_THETA_MAX]) {
        return ON_REFERENCE_OUTSIDE;
    }
    if (drive->state == HFP_ARMED) {
        bool near = distance(reference, theta_m_raw) <= (uint32_t)values[HFP_ROW_REFERENCE_TOLERANCE];
        return near ? ON_REFERENCE : ON_REFERENCE_OFF;
    }
    if (distance(reference, drive->reference_raw) > (uint32_t)values[HFP_ROW_MAX_STEP] * steps) {
        return ON_REFERENCE_JUMP;
    }
    return ON_REFERENCE;
}

void hfp_take_reference(
    hfp_drive *drive, const hfp_reference *reference, uint32_t now_us, int32_t theta_m_raw)
{
    uint8_t advance = freshness(drive, reference);

    if (advance == 0) {
        return;
    }
    hfp_event what = judge_reference(drive, reference->raw, advance, theta_m_raw);
    hfp_fire(drive, what);
    if (what == ON_REFERENCE) {
        drive->fed_us = now_us;
        drive->setpoint_sequence = reference->sequence;
        drive->reference_raw = reference->raw;
        drive->counters[HFP_COUNT_SETPOINTS_ACCEPTED]++;
        drive->counters[HFP_COUNT_SETPOINTS_LOST] += advance - 1u;
    }
}
