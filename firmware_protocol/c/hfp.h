/*
 * Drive end of the motor driver protocol, version 1.0: docs/protocol.md is the specification, docs/porting.md the way
 * onto a microcontroller. Not a medical device.
 *
 * C99. No heap, no globals, no IO: all state is in structs of the caller, the outside is reached through `hfp_port`.
 * Nothing here is reentrant: call all functions of one object from one level of priority.
 *
 * Three layers, each usable without those after it: frames (check values, serial line), `hfp_drive` (states and answers,
 * without IO), `hfp_node` (the drive with its position loop, behind the port).
 */
#ifndef HFP_H
#define HFP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* ---- frames ------------------------------------------------------------------------------------------------------ */

enum {
    HFP_PROTOCOL_MAJOR = 1,
    HFP_PROTOCOL_MINOR = 0,
    HFP_MAX_ID = 0x7FF,
    HFP_MAX_NODE = 30,
    HFP_MAX_CLASSIC_PAYLOAD = 8,
    HFP_MAX_PAYLOAD = 64
};

/* One data frame with an 11-bit id. FD frames are sent with bit-rate switch (HFP-172). */
typedef struct {
    uint16_t id;
    bool is_fd;
    uint8_t length;
    uint8_t data[HFP_MAX_PAYLOAD];
} hfp_frame;

/* Function code: the upper six bits of the id. */
typedef enum {
    HFP_ESTOP = 0x00,
    HFP_SETPOINT = 0x02,
    HFP_FD_SETPOINT = 0x03,
    HFP_FEEDBACK = 0x04,
    HFP_TIMING = 0x05,
    HFP_FD_FEEDBACK = 0x06,
    HFP_HOST_HEARTBEAT = 0x08,
    HFP_DRIVE_HEARTBEAT = 0x09,
    HFP_BENCH_SENSOR = 0x0A,
    HFP_PARAM_REQUEST = 0x10,
    HFP_PARAM_RESPONSE = 0x11,
    HFP_DISCOVER = 0x18,
    HFP_IDENTITY = 0x19,
    HFP_ASSIGN_NODE = 0x1A
} hfp_function;

typedef enum { HFP_INTACT, HFP_UNKNOWN_ID, HFP_BAD_LENGTH, HFP_BAD_FORMAT, HFP_BAD_CRC } hfp_verdict;

uint16_t hfp_id(hfp_function function, uint8_t node);

/* CRC-8 AUTOSAR and CRC-16 CCITT of id and payload; the second also runs over serial packets. */
uint8_t hfp_crc8(uint16_t id, const uint8_t *data, size_t length);
uint16_t hfp_crc16(uint16_t crc, const uint8_t *data, size_t length);

/* Judge a frame by its id: format, length, check value; any id, any length. */
hfp_verdict hfp_verify(const hfp_frame *frame);

/* Write id, format, length and check value of a message whose other fields are in `data` already. */
void hfp_seal(hfp_frame *frame, hfp_function function, uint8_t node);

/* ---- serial line: COBS, CRC-16, zero byte ------------------------------------------------------------------------ */

enum {
    HFP_PACKET_OVERHEAD = 5, /* id, CRC, one byte of COBS */
    HFP_MAX_PACKET = HFP_MAX_PAYLOAD + HFP_PACKET_OVERHEAD + 1 /* its delimiter */
};

typedef enum {
    HFP_SERIAL_BAD_COBS,
    HFP_SERIAL_TOO_SHORT,
    HFP_SERIAL_TOO_LONG,
    HFP_SERIAL_BAD_CRC,
    HFP_SERIAL_BAD_ID,
    HFP_SERIAL_BAD_LENGTH,
    HFP_SERIAL_COUNTERS
} hfp_serial_counter;

typedef struct {
    uint64_t counters[HFP_SERIAL_COUNTERS];
    uint8_t line; /* where in a packet we are */
    uint8_t length;
    uint8_t longest;
    uint8_t packet[HFP_MAX_PACKET];
} hfp_serial_reader;

/* Write the packet with its delimiter; return its length, 0 when no CAN frame has this id or length. */
size_t hfp_serial_encode(const hfp_frame *frame, uint8_t packet[HFP_MAX_PACKET]);

/* Start a reader that takes payloads up to `max_payload`, 8 to 64; false when it is neither. */
bool hfp_serial_init(hfp_serial_reader *reader, uint8_t max_payload);

/* Take one byte; true when it completes `frame`. */
bool hfp_serial_feed(hfp_serial_reader *reader, uint8_t byte, hfp_frame *frame);

/* ---- drive: states and answers ----------------------------------------------------------------------------------- */

typedef enum { HFP_DISABLED, HFP_ARMED, HFP_OPERATIONAL, HFP_FAULT, HFP_STATES } hfp_state;

typedef enum {
    HFP_FAULT_NONE,
    HFP_FAULT_ESTOP,
    HFP_FAULT_WATCHDOG,
    HFP_FAULT_HOST_HEARTBEAT_LOST,
    HFP_FAULT_REFERENCE_MISMATCH,
    HFP_FAULT_REFERENCE_POSITION,
    HFP_FAULT_REFERENCE_RATE,
    HFP_FAULT_ENABLE_TIMEOUT,
    HFP_FAULT_VERSION,
    HFP_FAULT_OVERCURRENT,
    HFP_FAULT_ENCODER,
    HFP_FAULT_SUPPLY,
    HFP_FAULT_OVERTEMPERATURE,
    HFP_FAULT_BUS_OFF,
    HFP_FAULT_INTERNAL,
    HFP_FAULTS
} hfp_fault;

/* Of 64 bits: they do not wrap while a device lives. All before HFP_NOT_FOR_US make up `rejected` (HFP-086). */
typedef enum {
    HFP_COUNT_UNKNOWN_ID,
    HFP_COUNT_BAD_LENGTH,
    HFP_COUNT_BAD_FORMAT,
    HFP_COUNT_BAD_CRC,
    HFP_COUNT_NOT_ENABLED,
    HFP_COUNT_SETPOINT_STALE,
    HFP_COUNT_SAMPLE_OLD,
    HFP_COUNT_SAMPLE_FUTURE,
    HFP_COUNT_HEARTBEAT_STALE,
    HFP_COUNT_PARAM_REFUSED,
    HFP_COUNT_ASSIGN_REFUSED,
    HFP_COUNT_NOT_FOR_US,
    HFP_COUNT_SETPOINTS_ACCEPTED,
    HFP_COUNT_SETPOINTS_LOST,
    HFP_COUNT_FAULTS,
    HFP_COUNTERS
} hfp_counter;

/* Rows of the parameter dictionary, in its order; indices and bounds are in hfp_parameters.c. */
typedef enum {
    HFP_ROW_PROTOCOL_MAJOR,
    HFP_ROW_PROTOCOL_MINOR,
    HFP_ROW_NODE,
    HFP_ROW_SERIAL_LOW,
    HFP_ROW_SERIAL_HIGH,
    HFP_ROW_FD,
    HFP_ROW_THETA_MIN,
    HFP_ROW_THETA_MAX,
    HFP_ROW_MAX_STEP,
    HFP_ROW_REFERENCE_TOLERANCE,
    HFP_ROW_WATCHDOG_TIMEOUT,
    HFP_ROW_HOST_HEARTBEAT_TIMEOUT,
    HFP_ROW_HEARTBEAT_PERIOD,
    HFP_ROW_ARM_TIMEOUT,
    HFP_ROW_MAX_SAMPLE_AGE,
    HFP_ROW_SAMPLE_PERIOD,
    HFP_ROW_COUNTS_PER_REV,
    HFP_ROW_TORQUE_CONSTANT,
    HFP_ROW_REJECTED,
    HFP_ROW_SETPOINTS_ACCEPTED,
    HFP_ROW_SETPOINTS_LOST,
    HFP_ROWS
} hfp_row;

/* What a drive is told once: angles in 2^-24 rev, times in us. `hfp_config_default` fills in the defaults. */
typedef struct {
    uint64_t serial_number; /* 48 bits */
    uint8_t node;
    bool fd;
    int32_t theta_min_raw;
    int32_t theta_max_raw;
    int32_t max_step_raw;
    int32_t reference_tolerance_raw;
    int32_t watchdog_timeout_us;
    int32_t host_heartbeat_timeout_us;
    int32_t heartbeat_period_us;
    int32_t arm_timeout_us;
    int32_t max_sample_age;
    int32_t sample_period_us;
    int32_t counts_per_rev;
    int32_t torque_constant_nN_m_per_A;
} hfp_config;

/* Read what stands before `counters` and the counters; the rest is the drive's own. */
typedef struct {
    uint8_t state; /* hfp_state */
    uint8_t fault; /* hfp_fault */
    uint8_t node;
    bool has_reference; /* only in OPERATIONAL; without one the motor gets no current */
    int32_t reference_raw; /* modulo 2^32: follow the congruent angle that is nearest (HFP-117) */
    uint64_t counters[HFP_COUNTERS];

    uint64_t serial_number;
    int32_t values[HFP_ROWS];
    uint32_t fed_us;
    uint32_t armed_us;
    uint32_t host_us;
    uint32_t heartbeat_us;
    uint32_t identity_due_us;
    bool has_sample;
    bool host_present;
    bool announce; /* a state not yet told by a heartbeat */
    bool identity_due;
    uint8_t sequence; /* of the newest sample */
    uint8_t setpoint_sequence;
    uint8_t host_sequence;
    uint8_t levels; /* control bits of the host heartbeat before */
    uint8_t heartbeat_sequence;
    uint8_t discoveries;
} hfp_drive;

enum { HFP_MAX_ANSWERS = 2 }; /* frames that one call gives */

hfp_config hfp_config_default(uint8_t node, uint64_t serial_number);

/* Power up; false when a setting is out of its bounds, and then nothing of the drive may be used. */
bool hfp_drive_init(hfp_drive *drive, const hfp_config *config);

/*
 * Take a frame, let time pass, number a measurement: each writes the frames to send and returns how many. `now_us` and
 * `stamp_us` come from one clock that wraps and never runs backwards; `theta_m_raw` is the angle now, modulo 2^32. Poll at
 * least once a millisecond and before using the reference.
 */
uint8_t hfp_drive_receive(
    hfp_drive *drive, const hfp_frame *frame, uint32_t now_us, int32_t theta_m_raw, hfp_frame answers[HFP_MAX_ANSWERS]);
uint8_t hfp_drive_poll(hfp_drive *drive, uint32_t now_us, hfp_frame answers[HFP_MAX_ANSWERS]);
uint8_t hfp_drive_sample(
    hfp_drive *drive, uint32_t stamp_us, int32_t theta_m_raw, int32_t current_raw, hfp_frame answers[HFP_MAX_ANSWERS]);

/* Fault for a reason of the device's own; HFP_FAULT_NONE changes nothing. */
void hfp_drive_trip(hfp_drive *drive, hfp_fault reason);

/* Frames for this drive that it dropped. */
uint64_t hfp_drive_rejected(const hfp_drive *drive);

/* ---- position loop ----------------------------------------------------------------------------------------------- */

/*
 * PID on the encoder angle, the derivative on the filtered speed; with a cascade time the position loop around a
 * velocity loop with the integral. All finite, not negative, the sample time positive.
 */
typedef struct {
    float sample_time_s;
    float kp_A_per_rad;
    float ki_A_per_rad_s;
    float kd_A_s_per_rad;
    float derivative_cutoff_Hz;
    float current_limit_A;
    float cascade_time_s; /* 0: a PID; else the integral takes in the error less this times the speed */
} hfp_loop_config;

typedef struct {
    float proportional_A; /* gains per unit of the wire and sample */
    float integral_A;
    float derivative_A;
    float speed_gain;
    float limit_A;
    float speed_raw; /* per sample, filtered */
    float cascade; /* cascade time over the sample time */
    float rest_raw; /* of the speed's share of the integral: what is no whole number */
    int64_t integral_limit_raw;
    int64_t integral_raw; /* an integer, so small errors are never lost in it */
    int32_t theta_raw; /* of the sample before */
} hfp_loop;

bool hfp_loop_init(hfp_loop *loop, const hfp_loop_config *config, int32_t theta_raw);

/* One sample: the current in A to hold until the next; nought and an empty memory while not active. */
float hfp_loop_step(hfp_loop *loop, bool active, int32_t reference_raw, int32_t theta_raw);

/* ---- node: the drive behind its port ----------------------------------------------------------------------------- */

/* Angle, current and clock of one instant (HFP-050, HFP-056). */
typedef struct {
    uint32_t stamp_us;
    int32_t theta_m_raw; /* 2^-24 rev, modulo 2^32 */
    int32_t current_raw; /* 0.2 mA; saturates on the wire */
} hfp_reading;

/* What a device fills in; none may block. `context` is the pointer given to `hfp_node_init`. */
typedef struct {
    bool (*receive)(void *context, hfp_frame *frame); /* false: none waits */
    bool (*send)(void *context, const hfp_frame *frame); /* false: no room, the frame is counted and gone */
    uint32_t (*now_us)(void *context); /* the clock of the stamps */
    void (*measure)(void *context, hfp_reading *reading);
    hfp_fault (*protection)(void *context); /* HFP_FAULT_NONE: all is well */
    void (*set_current)(void *context, float current_A); /* held until the next call */
    void (*keep_node)(void *context, uint8_t node); /* for the next power-up (HFP-067) */
} hfp_port;

typedef struct {
    hfp_drive drive;
    hfp_loop loop;
    const hfp_port *port;
    void *context;
    uint64_t unsent; /* frames that `send` had no room for */
    int32_t theta_m_raw; /* of the newest measurement */
    uint16_t feedback_divider;
    uint16_t until_feedback; /* samples */
} hfp_node;

enum { HFP_MAX_BURST = 32 }; /* frames taken by one call, so that a flood can't keep a node from its samples */

/* Power up with the motor without current; every `feedback_divider`-th sample is sent. False: a setting is no good. */
bool hfp_node_init(
    hfp_node *node,
    const hfp_config *config,
    const hfp_loop_config *loop,
    uint16_t feedback_divider,
    const hfp_port *port,
    void *context);

/* Take what has arrived and let time pass; as often as there is time, once a millisecond at least. */
void hfp_node_service(hfp_node *node);

/* One sample: time-outs, measurement, position loop, feedback; each `sample_time_s`, nothing may delay it. */
void hfp_node_sample(hfp_node *node);

#ifdef __cplusplus
}
#endif

#endif
