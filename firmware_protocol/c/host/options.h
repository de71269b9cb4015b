/* What the command line says. */
#ifndef OPTIONS_H
#define OPTIONS_H

#include "../hfp.h"

typedef struct {
    const char *pty; /* path of the link to the pseudo terminal */
    const char *udp; /* address:port */
    const char *can; /* name of a SocketCAN device */
    const char *plant; /* address:port; NULL: the test plant */
    bool stdio;
    double duration_s; /* 0: until told to end */
    uint16_t feedback_divider;
    hfp_config config;
    hfp_loop_config loop;
} options;

/* False: one line on standard error for each problem, or the help. */
bool options_parse(options *chosen, int count, char **arguments);

#endif
