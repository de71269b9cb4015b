/*
 * The drive's side of the protocol: frames, samples and times in, frames and a reference out. States and what changes them
 * are in hfp_states.c; here is what each message does and what the drive says of itself.
 */
#include "generated/motor_driver.h"
#include "hfp_private.h"

#include <string.h>

enum {
    ENABLE = 1,
    FAULT_RESET = 2,
    SLOTS = 64, /* of the answers to DISCOVER */
    SLOT_US = 500,
    SERIAL_BYTES = 6,
    REJECTED_MAX = 0xFFFF
};

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
    const hfp_reference reference = {setpoint.theta_m_ref, setpoint.sequence, setpoint.sample_sequence};
    hfp_take_reference(drive, &reference, in->now_us, in->theta_m_raw);
    return 0;
}

static uint8_t on_fd_setpoint(hfp_drive *drive, const arrival *in, hfp_frame *answer)
{
    struct motor_driver_fd_setpoint_t setpoint;

    (void)answer;
    (void)motor_driver_fd_setpoint_unpack(&setpoint, in->frame->data, in->frame->length);
    const hfp_reference reference = {setpoint.theta_m_ref, setpoint.sequence, setpoint.sample_sequence};
    hfp_take_reference(drive, &reference, in->now_us, in->theta_m_raw);
    return 0;
}

static uint8_t on_host_heartbeat(hfp_drive *drive, const arrival *in, hfp_frame *answer)
{
    struct motor_driver_host_heartbeat_t host;

    (void)answer;
    (void)motor_driver_host_heartbeat_unpack(&host, in->frame->data, in->frame->length);
    uint8_t advance = (uint8_t)(host.sequence - drive->host_sequence);
    if (drive->host_present && (advance < 1 || advance > HFP_MAX_ADVANCE)) {
        return hfp_drop(drive, HFP_COUNT_HEARTBEAT_STALE);
    }
    uint8_t rising = (uint8_t)(host.control & ~drive->levels);
    drive->host_present = true;
    drive->host_us = in->now_us;
    drive->host_sequence = host.sequence;
    drive->levels = host.control;
    if ((host.control & ENABLE) == 0) {
        hfp_fire(drive, ON_DISABLE);
    } else if (host.protocol_major != HFP_PROTOCOL_MAJOR) {
        if ((rising & ENABLE) != 0 || drive->state != HFP_DISABLED) {
            hfp_fire(drive, ON_VERSION_MISFIT);
        }
    } else if ((rising & ENABLE) != 0 && drive->state == HFP_DISABLED) {
        drive->armed_us = in->now_us;
        hfp_fire(drive, ON_ENABLE);
    }
    if ((rising & FAULT_RESET) != 0) { /* after ENABLE, so one heartbeat that raises both resets and does not enable */
        hfp_fire(drive, ON_RESET);
    }
    return 0;
}

static uint8_t on_estop(hfp_drive *drive, const arrival *in, hfp_frame *answer)
{
    (void)in;
    (void)answer;
    hfp_fire(drive, ON_ESTOP);
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
        hfp_drop(drive, HFP_COUNT_PARAM_REFUSED);
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
        return hfp_drop(drive, HFP_COUNT_NOT_FOR_US);
    }
    if (drive->state != HFP_DISABLED || order.new_node < 1 || order.new_node > HFP_MAX_NODE) {
        return hfp_drop(drive, HFP_COUNT_ASSIGN_REFUSED);
    }
    drive->node = order.new_node;
    drive->values[HFP_ROW_NODE] = order.new_node;
    hfp_forget_host(drive);
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
        return hfp_drop(drive, HFP_COUNT_NOT_FOR_US);
    }
    hfp_expire(drive, now_us);
    hfp_verdict verdict = hfp_verify(frame);
    if (verdict != HFP_INTACT) {
        return hfp_drop(drive, (hfp_counter)VERDICT_COUNTERS[verdict]);
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

    hfp_expire(drive, now_us);
    if (drive->announce || hfp_has_passed(drive->heartbeat_us, now_us, drive->values[HFP_ROW_HEARTBEAT_PERIOD])) {
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
        hfp_fire_for(drive, ON_TRIP, (uint8_t)reason);
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
    hfp_forget_host(drive);
    return hfp_parameters_init(drive->values, config);
}
