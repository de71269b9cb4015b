/* The same frames over a byte stream (HFP-160 to HFP-167). */
#include "hfp_private.h"

#include <string.h>

enum { FD_FLAG = 0x8000, HEAD = 2, TAIL = 2 };

/* The line as a table: where we are in a packet, and what a byte does there. */
enum { BETWEEN, GATHERING, SKIPPING };
enum { DELIMITER, BYTE_FITS, BYTE_TOO_MANY };
enum { NOTHING, STORE, TAKE, COUNT_TOO_LONG };

typedef struct {
    uint8_t next;
    uint8_t action;
} step;

static const step LINE[3][3] = {
    [BETWEEN] = {{BETWEEN, NOTHING}, {GATHERING, STORE}, {SKIPPING, COUNT_TOO_LONG}},
    [GATHERING] = {{BETWEEN, TAKE}, {GATHERING, STORE}, {SKIPPING, COUNT_TOO_LONG}},
    [SKIPPING] = {{BETWEEN, NOTHING}, {SKIPPING, NOTHING}, {SKIPPING, NOTHING}},
};

static bool length_fits(uint8_t length, bool is_fd)
{
    static const uint8_t LONGER[] = {12, 16, 20, 24, 32, 48, 64};

    if (length <= HFP_MAX_CLASSIC_PAYLOAD) {
        return true;
    }
    return is_fd && memchr(LONGER, length, sizeof LONGER) != NULL;
}

size_t hfp_serial_encode(const hfp_frame *frame, uint8_t packet[HFP_MAX_PACKET])
{
    uint8_t plain[HEAD + HFP_MAX_PAYLOAD + TAIL];
    uint8_t body = (uint8_t)(HEAD + frame->length);
    size_t run = 0; /* where the length of the run under way goes */
    size_t end = 1;

    if (frame->id > HFP_MAX_ID || !length_fits(frame->length, frame->is_fd)) {
        return 0;
    }
    hfp_store16(plain, (uint16_t)(frame->is_fd ? frame->id | FD_FLAG : frame->id));
    memcpy(&plain[HEAD], frame->data, frame->length);
    hfp_store16(&plain[body], hfp_crc16(HFP_CRC16_INIT, plain, body));
    for (uint8_t i = 0; i < body + TAIL; i++) {
        if (plain[i] == 0) {
            packet[run] = (uint8_t)(end - run);
            run = end;
        } else {
            packet[end] = plain[i];
        }
        end++;
    }
    packet[run] = (uint8_t)(end - run);
    packet[end] = 0;
    return end + 1;
}

/* Undo COBS in place: packets are shorter than its longest run, so each run's length byte stands where a zero was. */
static bool cobs_decode(uint8_t *packet, uint8_t length)
{
    unsigned at = 0;

    while (at < length) {
        uint8_t run = packet[at];
        packet[at] = 0;
        at += run;
    }
    return at == length;
}

/* Read a packet without its delimiter; HFP_SERIAL_COUNTERS: `frame` holds it, else what is wrong with it. */
static hfp_serial_counter parse(hfp_serial_reader *reader, hfp_frame *frame)
{
    const uint8_t *plain = &reader->packet[1];
    uint8_t length = (uint8_t)(reader->length - 1);

    if (!cobs_decode(reader->packet, reader->length)) {
        return HFP_SERIAL_BAD_COBS;
    }
    if (length < HEAD + TAIL) {
        return HFP_SERIAL_TOO_SHORT;
    }
    uint8_t body = (uint8_t)(length - TAIL);
    if (hfp_crc16(HFP_CRC16_INIT, plain, body) != hfp_load16(&plain[body])) {
        return HFP_SERIAL_BAD_CRC;
    }
    uint16_t word = hfp_load16(plain);
    frame->is_fd = (word & FD_FLAG) != 0;
    frame->id = (uint16_t)(word & ~FD_FLAG);
    frame->length = (uint8_t)(body - HEAD);
    if (frame->id > HFP_MAX_ID) {
        return HFP_SERIAL_BAD_ID;
    }
    if (!length_fits(frame->length, frame->is_fd)) {
        return HFP_SERIAL_BAD_LENGTH;
    }
    memcpy(frame->data, &plain[HEAD], frame->length);
    return HFP_SERIAL_COUNTERS;
}

bool hfp_serial_init(hfp_serial_reader *reader, uint8_t max_payload)
{
    if (max_payload < HFP_MAX_CLASSIC_PAYLOAD || max_payload > HFP_MAX_PAYLOAD) {
        return false;
    }
    memset(reader, 0, sizeof *reader);
    reader->longest = (uint8_t)(max_payload + HFP_PACKET_OVERHEAD);
    return true;
}

static bool take(hfp_serial_reader *reader, hfp_frame *frame)
{
    hfp_serial_counter outcome = parse(reader, frame);

    reader->length = 0;
    if (outcome == HFP_SERIAL_COUNTERS) {
        return true;
    }
    reader->counters[outcome]++;
    return false;
}

bool hfp_serial_feed(hfp_serial_reader *reader, uint8_t byte, hfp_frame *frame)
{
    unsigned event = reader->length < reader->longest ? BYTE_FITS : BYTE_TOO_MANY;
    const step *to = &LINE[reader->line][byte == 0 ? DELIMITER : event];

    reader->line = to->next;
    switch (to->action) {
    case STORE:
        reader->packet[reader->length++] = byte;
        return false;
    case TAKE:
        return take(reader, frame);
    case COUNT_TOO_LONG:
        reader->counters[HFP_SERIAL_TOO_LONG]++;
        reader->length = 0;
        return false;
    default:
        return false;
    }
}
