/* Vectors and reset of any ARMv7E-M; nothing here uses an interrupt. */
#include <stdint.h>

extern uint32_t _data_load, _data_start, _data_end, _bss_start, _bss_end, _stack_top;

int main(void);
void reset_handler(void);
void default_handler(void);

typedef void (*vector)(void);

__attribute__((section(".vectors"), used)) static const vector VECTORS[16] = {
    (vector)(uintptr_t)&_stack_top, reset_handler, default_handler, default_handler, default_handler, default_handler,
    default_handler};

void reset_handler(void)
{
    const uint32_t *from = &_data_load;

    for (uint32_t *to = &_data_start; to < &_data_end; to++) {
        *to = *from++;
    }
    for (uint32_t *to = &_bss_start; to < &_bss_end; to++) {
        *to = 0;
    }
    *(volatile uint32_t *)0xE000ED88U |= 0xFU << 20; /* CPACR: the FPU on */
    __asm volatile("dsb\n isb");
    (void)main();
    for (;;) {
    }
}

void default_handler(void)
{
    for (;;) {
    }
}
