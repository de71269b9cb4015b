/*
 * The drive's side of the protocol: frames, samples and times in, frames and a reference out.
 *
 * What changes its state is the table TRANSITIONS; the rest says which frame or delay is which event. The same machine
 * is firmware_protocol/drive_machine.py, and tests compare the two.
 */
#include "generated/motor_driver.h"
#include "hfp_private.h"

#include <string.h>

enum {
    MAX_ADVANCE = 127, /* sequence numbers ahead that count as new; what is further ahead is taken for old */
    MAX_STEP_FACTOR = 8, /* steps that lost setpoints may add to the step limit */
    ENABLE = 1,
    FAULT_RESET = 2,
    ALL_CONTROLS = 0xFF, /* taken as high until a host has shown them low: a drive that restarts stays put */
    SLOTS = 64, /* of the answers to DISCOVER */
    SLOT_US = 500,
    SERIAL_BYTES = 6,
    REJECTED_MAX = 0xFFFF
};

typedef enum {
    ON_ENABLE, /* rising edge of ENABLE from a host whose version fits */
    ON_VERSION_MISFIT,
    ON_DISABLE, /* ENABLE low */
    ON_RESET, /* rising edge of FAULT_RESET */
    ON_REFERENCE, /* fresh, within limits; in ARMED also within tolerance of the measured angle */
    ON_REFERENCE_OFF, /* fresh, but in ARMED too far from the measured angle */
    ON_REFERENCE_OUTSIDE,
    ON_REFERENCE_JUMP,
    ON_WATCHDOG_EXPIRED,
    ON_HOST_LOST,
    ON_ARM_EXPIRED,
    ON_ESTOP,
    ON_TRIP, /* the device's own protection */
    EVENTS
} event;

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

static void fire_for(hfp_drive *drive, event what, uint8_t reason)
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

static void fire(hfp_drive *drive, event what)
{
    fire_for(drive, what, REASONS[what]);
}

static void forget_host(hfp_drive *drive)
{
    drive->host_present = false;
    drive->levels = ALL_CONTROLS;
}

static bool has_passed(uint32_t since_us, uint32_t now_us, int32_t timeout_us)
{
    return now_us - since_us >= (uint32_t)timeout_us;
}

static void expire(hfp_drive *drive, uint32_t now_us)
{
    const int32_t *values = drive->values;

    if (drive->state == HFP_OPERATIONAL && has_passed(drive->fed_us, now_us, values[HFP_ROW_WATCHDOG_TIMEOUT])) {
        fire(drive, ON_WATCHDOG_EXPIRED);
    } else if (drive->state == HFP_ARMED && has_passed(drive->armed_us, now_us, values[HFP_ROW_ARM_TIMEOUT])) {
        fire(drive, ON_ARM_EXPIRED);
    }
    if (drive->host_present && has_passed(drive->host_us, now_us, values[HFP_ROW_HOST_HEARTBEAT_TIMEOUT])) {
        forget_host(drive);
        fire(drive, ON_HOST_LOST);
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

static uint8_t drop(hfp_drive *drive, hfp_counter reason)
{
    drive->counters[reason]++;
    return 0;
}

/* By how much the sequence advanced (1 for the first of a session); 0 when not fresh or not wanted, and counted. */
static uint8_t freshness(hfp_drive *drive, const struct motor_driver_setpoint_t *setpoint)
{
    uint8_t age = (uint8_t)(drive->sequence - setpoint->sample_sequence);
    uint8_t advance = (uint8_t)(setpoint->sequence - drive->setpoint_sequence);

    if (drive->state != HFP_ARMED && drive->state != HFP_OPERATIONAL) {
        return drop(drive, HFP_COUNT_NOT_ENABLED);
    }
    if (!drive->has_sample || age > MAX_ADVANCE) {
        return drop(drive, HFP_COUNT_SAMPLE_FUTURE);
    }
    if (age > drive->values[HFP_ROW_MAX_SAMPLE_AGE]) {
        return drop(drive, HFP_COUNT_SAMPLE_OLD);
    }
    if (drive->state == HFP_ARMED) {
        return 1;
    }
    return advance >= 1 && advance <= MAX_ADVANCE ? advance : drop(drive, HFP_COUNT_SETPOINT_STALE);
}

static event judge_reference(const hfp_drive *drive, int32_t reference, uint8_t advance, int32_t theta_m_raw)
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

static void take_setpoint(
    hfp_drive *drive, const struct motor_driver_setpoint_t *setpoint, uint32_t now_us, int32_t theta_m_raw)
{
    uint8_t advance = freshness(drive, setpoint);

    if (advance == 0) {
        return;
    }
    event what = judge_reference(drive, setpoint->theta_m_ref, advance, theta_m_raw);
    fire(drive, what);
    if (what == ON_REFERENCE) {
        drive->fed_us = now_us;
        drive->setpoint_sequence = setpoint->sequence;
        drive->reference_raw = setpoint->theta_m_ref;
        drive->counters[HFP_COUNT_SETPOINTS_ACCEPTED]++;
        drive->counters[HFP_COUNT_SETPOINTS_LOST] += advance - 1u;
    }
}

/* ---- one function for each message ------------------------------------------------------------------------------- */

typedef struct {
    const hfp_frame *frame;
    uint32_t now_us;
    int32_t theta_m_raw;
} arrival;

static uint8_t on_setpoint(hfp_drive *drive, const arrival *in, hfp_frame *answer)
{
    struct motor_driver_setpoint_t setpoint;

    (void)answer;
    (void)motor_driver_setpoint_unpack(&setpoint, in->frame->data, in->frame->length);
    take_setpoint(drive, &setpoint, in->now_us, in->theta_m_raw);
    return 0;
}

static uint8_t on_fd_setpoint(hfp_drive *drive, const arrival *in, hfp_frame *answer)
{
    struct motor_driver_fd_setpoint_t fd;

    (void)answer;
    (void)motor_driver_fd_setpoint_unpack(&fd, in->frame->data, in->frame->length);
    const struct motor_driver_setpoint_t setpoint = {fd.theta_m_ref, fd.sequence, fd.sample_sequence, 0};
    take_setpoint(drive, &setpoint, in->now_us, in->theta_m_raw);
    return 0;
}

static uint8_t on_host_heartbeat(hfp_drive *drive, const arrival *in, hfp_frame *answer)
{
    struct motor_driver_host_heartbeat_t host;

    (void)answer;
    (void)motor_driver_host_heartbeat_unpack(&host, in->frame->data, in->frame->length);
    uint8_t advance = (uint8_t)(host.sequence - drive->host_sequence);
    if (drive->host_present && (advance < 1 || advance > MAX_ADVANCE)) {
        return drop(drive, HFP_COUNT_HEARTBEAT_STALE);
    }
    uint8_t rising = (uint8_t)(host.control & ~drive->levels);
    drive->host_present = true;
    drive->host_us = in->now_us;
    drive->host_sequence = host.sequence;
    drive->levels = host.control;
    if ((host.control & ENABLE) == 0) {
        fire(drive, ON_DISABLE);
    } else if (host.protocol_major != HFP_PROTOCOL_MAJOR) {
        if ((rising & ENABLE) != 0 || drive->state != HFP_DISABLED) {
            fire(drive, ON_VERSION_MISFIT);
        }
    } else if ((rising & ENABLE) != 0 && drive->state == HFP_DISABLED) {
        drive->armed_us = in->now_us;
        fire(drive, ON_ENABLE);
    }
    if ((rising & FAULT_RESET) != 0) { /* after ENABLE, so one heartbeat that raises both resets and does not enable */
        fire(drive, ON_RESET);
    }
    return 0;
}

static uint8_t on_estop(hfp_drive *drive, const arrival *in, hfp_frame *answer)
{
    (void)in;
    (void)answer;
    fire(drive, ON_ESTOP);
    return 0;
}

static int32_t saturated(uint64_t count)
{
    return count < INT32_MAX ? (int32_t)count : INT32_MAX;
}

static uint8_t on_param_request(hfp_drive *drive, const arrival *in, hfp_frame *answer)
{
    struct motor_driver_param_request_t request;
    struct motor_driver_param_response_t response = {0};
    int32_t *values = drive->values;

    (void)motor_driver_param_request_unpack(&request, in->frame->data, in->frame->length);
    values[HFP_ROW_REJECTED] = saturated(hfp_drive_rejected(drive));
    values[HFP_ROW_SETPOINTS_ACCEPTED] = saturated(drive->counters[HFP_COUNT_SETPOINTS_ACCEPTED]);
    values[HFP_ROW_SETPOINTS_LOST] = saturated(drive->counters[HFP_COUNT_SETPOINTS_LOST]);
    response.parameter = request.parameter;
    response.op = hfp_parameters_execute(
        values, request.op, request.parameter, request.value, drive->state == HFP_DISABLED, &response.value);
    if (response.op != HFP_OP_OK) {
        drop(drive, HFP_COUNT_PARAM_REFUSED);
    }
    (void)motor_driver_param_response_pack(answer->data, &response, sizeof answer->data);
    hfp_seal(answer, HFP_PARAM_RESPONSE, drive->node);
    return 1;
}

/* Two drives that share a node id send IDENTITY under one id, so they must not send together (HFP-061). */
static uint32_t identity_delay_us(uint64_t serial_number, uint8_t discoveries)
{
    uint8_t seed[SERIAL_BYTES + 1];

    for (unsigned i = 0; i < SERIAL_BYTES; i++) {
        seed[i] = (uint8_t)(serial_number >> 8 * i);
    }
    seed[SERIAL_BYTES] = discoveries;
    return (uint32_t)(hfp_crc16(HFP_CRC16_INIT, seed, sizeof seed) % SLOTS * SLOT_US);
}

static uint8_t on_discover(hfp_drive *drive, const arrival *in, hfp_frame *answer)
{
    (void)answer;
    if (!drive->identity_due) {
        drive->identity_due = true;
        drive->identity_due_us = in->now_us + identity_delay_us(drive->serial_number, drive->discoveries++);
    }
    return 0;
}

static void write_identity(const hfp_drive *drive, hfp_frame *answer)
{
    const struct motor_driver_identity_t identity = {drive->serial_number, HFP_PROTOCOL_MAJOR, HFP_PROTOCOL_MINOR};

    (void)motor_driver_identity_pack(answer->data, &identity, sizeof answer->data);
    hfp_seal(answer, HFP_IDENTITY, drive->node);
}

static uint8_t on_assign_node(hfp_drive *drive, const arrival *in, hfp_frame *answer)
{
    struct motor_driver_assign_node_t order;

    (void)motor_driver_assign_node_unpack(&order, in->frame->data, in->frame->length);
    if (order.serial_number != drive->serial_number) {
        return drop(drive, HFP_COUNT_NOT_FOR_US);
    }
    if (drive->state != HFP_DISABLED || order.new_node < 1 || order.new_node > HFP_MAX_NODE) {
        return drop(drive, HFP_COUNT_ASSIGN_REFUSED);
    }
    drive->node = order.new_node;
    drive->values[HFP_ROW_NODE] = order.new_node;
    forget_host(drive);
    write_identity(drive, answer);
    return 1;
}

/* ---- who acts on which id ---------------------------------------------------------------------------------------- */

enum { TO_OWN = 1, TO_ALL = 2, CLASSIC_DRIVE = 4, FD_DRIVE = 8, EITHER = CLASSIC_DRIVE | FD_DRIVE };

typedef struct {
    uint8_t function;
    uint8_t when;
    uint8_t (*handle)(hfp_drive *drive, const arrival *in, hfp_frame *answer);
} route;

static const route ROUTES[] = {
    {HFP_SETPOINT, TO_OWN | CLASSIC_DRIVE, on_setpoint},
    {HFP_FD_SETPOINT, TO_OWN | FD_DRIVE, on_fd_setpoint},
    {HFP_HOST_HEARTBEAT, TO_OWN | EITHER, on_host_heartbeat},
    {HFP_ESTOP, TO_OWN | TO_ALL | EITHER, on_estop},
    {HFP_PARAM_REQUEST, TO_OWN | EITHER, on_param_request},
    {HFP_DISCOVER, TO_OWN | TO_ALL | EITHER, on_discover},
    {HFP_ASSIGN_NODE, TO_ALL | EITHER, on_assign_node},
};

enum { ROUTE_COUNT = sizeof ROUTES / sizeof ROUTES[0] };

static const route *route_of(const hfp_drive *drive, uint16_t id)
{
    uint8_t node = hfp_node_of(id);
    uint8_t variant = drive->values[HFP_ROW_FD] != 0 ? FD_DRIVE : CLASSIC_DRIVE;
    uint8_t address = node == 0 ? TO_ALL : TO_OWN;

    if (node != 0 && node != drive->node) {
        return NULL;
    }
    for (unsigned i = 0; i < ROUTE_COUNT; i++) {
        const route *row = &ROUTES[i];
        if (row->function == hfp_function_of(id) && (row->when & variant) != 0 && (row->when & address) != 0) {
            return row;
        }
    }
    return NULL;
}

static const uint8_t VERDICT_COUNTERS[] = {
    [HFP_UNKNOWN_ID] = HFP_COUNT_UNKNOWN_ID,
    [HFP_BAD_LENGTH] = HFP_COUNT_BAD_LENGTH,
    [HFP_BAD_FORMAT] = HFP_COUNT_BAD_FORMAT,
    [HFP_BAD_CRC] = HFP_COUNT_BAD_CRC,
};

uint8_t hfp_drive_receive(
    hfp_drive *drive, const hfp_frame *frame, uint32_t now_us, int32_t theta_m_raw, hfp_frame answers[HFP_MAX_ANSWERS])
{
    const arrival in = {frame, now_us, theta_m_raw};
    const route *row = route_of(drive, frame->id);

    if (row == NULL) {
        return drop(drive, HFP_COUNT_NOT_FOR_US);
    }
    expire(drive, now_us);
    hfp_verdict verdict = hfp_verify(frame);
    if (verdict != HFP_INTACT) {
        return drop(drive, (hfp_counter)VERDICT_COUNTERS[verdict]);
    }
    return row->handle(drive, &in, &answers[0]);
}

/* ---- what the drive says of itself ------------------------------------------------------------------------------- */

static void write_heartbeat(hfp_drive *drive, hfp_frame *answer)
{
    uint64_t rejected = hfp_drive_rejected(drive);
    const struct motor_driver_drive_heartbeat_t heartbeat = {
        .state = drive->state,
        .fault = drive->fault,
        .protocol_major = HFP_PROTOCOL_MAJOR,
        .protocol_minor = HFP_PROTOCOL_MINOR,
        .rejected = (uint16_t)(rejected < REJECTED_MAX ? rejected : REJECTED_MAX),
        .setpoints_lost = (uint8_t)drive->counters[HFP_COUNT_SETPOINTS_LOST],
        .sequence = drive->heartbeat_sequence++,
    };

    (void)motor_driver_drive_heartbeat_pack(answer->data, &heartbeat, sizeof answer->data);
    hfp_seal(answer, HFP_DRIVE_HEARTBEAT, drive->node);
}

uint8_t hfp_drive_poll(hfp_drive *drive, uint32_t now_us, hfp_frame answers[HFP_MAX_ANSWERS])
{
    uint8_t count = 0;

    expire(drive, now_us);
    if (drive->announce || has_passed(drive->heartbeat_us, now_us, drive->values[HFP_ROW_HEARTBEAT_PERIOD])) {
        drive->announce = false;
        drive->heartbeat_us = now_us;
        write_heartbeat(drive, &answers[count++]);
    }
    if (drive->identity_due && now_us - drive->identity_due_us <= INT32_MAX) {
        drive->identity_due = false;
        write_identity(drive, &answers[count++]);
    }
    return count;
}

static int16_t to_int16(int32_t value)
{
    if (value < INT16_MIN) {
        return INT16_MIN;
    }
    return value > INT16_MAX ? INT16_MAX : (int16_t)value;
}

uint8_t hfp_drive_sample(
    hfp_drive *drive, uint32_t stamp_us, int32_t theta_m_raw, int32_t current_raw, hfp_frame answers[HFP_MAX_ANSWERS])
{
    int16_t current = to_int16(current_raw);
    uint8_t sequence = ++drive->sequence;
    uint8_t echo = drive->setpoint_sequence;

    drive->has_sample = true;
    if (drive->values[HFP_ROW_FD] != 0) {
        const struct motor_driver_fd_feedback_t both = {
            theta_m_raw, current, stamp_us, sequence, echo, drive->state, drive->fault, 0};
        (void)motor_driver_fd_feedback_pack(answers[0].data, &both, sizeof answers[0].data);
        hfp_seal(&answers[0], HFP_FD_FEEDBACK, drive->node);
        return 1;
    }
    const struct motor_driver_feedback_t feedback = {theta_m_raw, current, sequence, 0};
    const struct motor_driver_timing_t timing = {stamp_us, sequence, echo, drive->state, drive->fault, 0};
    (void)motor_driver_feedback_pack(answers[0].data, &feedback, sizeof answers[0].data);
    hfp_seal(&answers[0], HFP_FEEDBACK, drive->node);
    (void)motor_driver_timing_pack(answers[1].data, &timing, sizeof answers[1].data);
    hfp_seal(&answers[1], HFP_TIMING, drive->node);
    return 2;
}

void hfp_drive_trip(hfp_drive *drive, hfp_fault reason)
{
    if (reason != HFP_FAULT_NONE) {
        fire_for(drive, ON_TRIP, (uint8_t)reason);
    }
}

uint64_t hfp_drive_rejected(const hfp_drive *drive)
{
    uint64_t sum = 0;

    for (unsigned reason = 0; reason < HFP_COUNT_NOT_FOR_US; reason++) {
        sum += drive->counters[reason];
    }
    return sum;
}

bool hfp_drive_init(hfp_drive *drive, const hfp_config *config)
{
    memset(drive, 0, sizeof *drive);
    drive->node = config->node;
    drive->serial_number = config->serial_number;
    drive->sequence = UINT8_MAX; /* so the first is 0 */
    drive->announce = true;
    forget_host(drive);
    return hfp_parameters_init(drive->values, config);
}
