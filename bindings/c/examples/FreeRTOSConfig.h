/* The configuration of FreeRTOS for freertos.c: static memory only. */
#ifndef FREERTOS_CONFIG_H
#define FREERTOS_CONFIG_H

#define configUSE_PREEMPTION 1
#define configUSE_IDLE_HOOK 1
#define configUSE_TICK_HOOK 0
#define configCPU_CLOCK_HZ 16000000u
#define configTICK_RATE_HZ 1000 /* A tick is the library's millisecond. */
#define configTICK_TYPE_WIDTH_IN_BITS TICK_TYPE_WIDTH_32_BITS
#define configMAX_PRIORITIES 3
#define configMINIMAL_STACK_SIZE 128
#define configSUPPORT_STATIC_ALLOCATION 1
#define configSUPPORT_DYNAMIC_ALLOCATION 0
#define configKERNEL_PROVIDED_STATIC_MEMORY 1
#define INCLUDE_vTaskSuspend 1 /* portMAX_DELAY has no end. */

/* The STM32L4 has 4 bits of priority. Interrupts from 50h on may call the kernel. */
#define configPRIO_BITS 4
#define configKERNEL_INTERRUPT_PRIORITY 0xF0
#define configMAX_SYSCALL_INTERRUPT_PRIORITY 0x50

#define configASSERT(condition) \
    do { \
        if (!(condition)) { \
            for (;;) { \
            } \
        } \
    } while (0)

/* The names in the vector table of board.c. */
#define vPortSVCHandler svc
#define xPortPendSVHandler pend_sv
#define xPortSysTickHandler sys_tick

#endif
