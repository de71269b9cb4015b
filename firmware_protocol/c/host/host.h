/* The drive as a POSIX process: what its sources share. */
#ifndef HOST_H
#define HOST_H

#include "../hfp.h"

#include <netinet/in.h>

/* Frames as serial packets, through a stream of bytes or one a datagram; or frames of a CAN device. */
typedef struct {
    int in;
    int out;
    int far_end; /* of a pseudo terminal, kept open so that its settings survive a host that closes it; else -1 */
    bool datagrams;
    bool is_can;
    bool ended; /* the other side has closed for good */
    struct sockaddr_in peer; /* whoever sent last gets the answers */
    bool has_peer;
    hfp_serial_reader reader;
    uint8_t bytes[2048];
    size_t at;
    size_t filled;
} host_link;

/* Each opens a link and says where it is; false: errno says why. */
bool link_open_pty(host_link *link, const char *path, char *where, size_t size);
bool link_open_stdio(host_link *link, char *where, size_t size);
bool link_open_udp(host_link *link, const char *address, char *where, size_t size);
bool link_open_can(host_link *link, const char *device, char *where, size_t size);
void link_close(host_link *link, const char *path);
bool link_receive(host_link *link, hfp_frame *frame);
bool link_send(host_link *link, const hfp_frame *frame);

/* The part of link_receive and link_send that a CAN device wants. */
bool can_receive(host_link *link, hfp_frame *frame);
bool can_send(const host_link *link, const hfp_frame *frame);

/* Bind a datagram socket to "address:port"; -1: errno says why. */
int udp_bind(const char *address, struct sockaddr_in *bound);

/* TEST PLANT: a motor with inertia and viscous friction and nothing on its shaft, for trying the process alone. */
typedef struct {
    double theta_rad;
    double speed_rad_per_s;
} test_plant;

void test_plant_move(test_plant *plant, double current_A, double duration_s);
int32_t test_plant_theta_raw(const test_plant *plant);

/* The plant outside, which is also the clock: see lockstep.c. */
typedef struct {
    int socket;
    struct sockaddr_in peer;
    hfp_reading reading;
    uint32_t what;
} lockstep;

bool lockstep_wait(lockstep *plant, int timeout_ms);
bool lockstep_samples(const lockstep *plant);
bool lockstep_misses(const lockstep *plant, uint8_t taken); /* frames are still to come before time may go on */
void lockstep_answer(const lockstep *plant, const hfp_node *node, float current_A, uint8_t sent);

#endif
