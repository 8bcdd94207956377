/*
 * The board B-L475E-IOT01A (STM32L475VG) without HAL and C library, for the examples: a gripper on UART4 (D1 and D0 of the Arduino
 * connector) at 115 200 bit/s, and pins of port A that show its state.
 */
#ifndef BOARD_H
#define BOARD_H

#include "wsg.h"

#define BOARD_CLOCK_HZ 16000000u

/* Starts clock, pins and UART4. */
void board_start(void);

/* Starts an interrupt each millisecond, for a program without operating system. */
void board_start_tick(void);

/* Sends a byte if the UART has room for it, and returns 1 then. */
int board_send(uint8_t byte);

/* Shows a state: PA2 end of the program, PA3 motion, PA4 holding, PA5 connected, PA6 part lost or absent, PA7 FAST STOP, PA15
 * referenced. */
void board_show(const wsg_known_t *known, int is_done);

/* The program defines these functions: its main loop, its handler of received bytes and of the millisecond. */
int main(void);
void on_byte(uint8_t byte);
void sys_tick(void);

/* An operating system defines these handlers. */
void svc(void);
void pend_sv(void);

#endif
