/* The fuzz target without libFuzzer: as many pseudo-random histories as asked, the same at each run. */
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static uint32_t draw(uint32_t *state)
{
    *state ^= *state << 13;
    *state ^= *state >> 17;
    *state ^= *state << 5;
    return *state;
}

int main(int count, char **arguments)
{
    uint8_t data[4096];
    uint32_t state = 1;
    unsigned long runs = count > 1 ? strtoul(arguments[1], NULL, 10) : 1000;

    for (unsigned long run = 0; run < runs; run++) {
        size_t size = draw(&state) % sizeof data;
        for (size_t i = 0; i < size; i++) {
            data[i] = (uint8_t)(draw(&state) >> 8);
        }
        (void)LLVMFuzzerTestOneInput(data, size);
    }
    (void)printf("%lu histories\n", runs);
    return 0;
}
