/* Sizes and places for callers that can't see the header: the tests, from Python. */
#include "../hfp.h"

extern const size_t hfp_size_of_frame, hfp_size_of_config, hfp_size_of_drive, hfp_size_of_reader, hfp_size_of_loop,
    hfp_size_of_loop_config, hfp_size_of_node, hfp_size_of_port, hfp_offset_of_unsent;

const size_t hfp_size_of_frame = sizeof(hfp_frame);
const size_t hfp_size_of_config = sizeof(hfp_config);
const size_t hfp_size_of_drive = sizeof(hfp_drive);
const size_t hfp_size_of_reader = sizeof(hfp_serial_reader);
const size_t hfp_size_of_loop = sizeof(hfp_loop);
const size_t hfp_size_of_loop_config = sizeof(hfp_loop_config);
const size_t hfp_size_of_node = sizeof(hfp_node);
const size_t hfp_size_of_port = sizeof(hfp_port);
const size_t hfp_offset_of_unsent = offsetof(hfp_node, unsent);
