//! A template for your own board, here a NUCLEO-F446RE with `stm32f4xx-hal`; never executed. docs/porting.md explains it.
#![no_std]
#![no_main]

use cortex_m::peripheral::{NVIC, SCB, SYST};
use cortex_m_rt::{entry, exception};
use stm32f4xx_hal::gpio::{Output, Pin};
use stm32f4xx_hal::pac::{self, Interrupt, interrupt};
use stm32f4xx_hal::serial::{Event, Serial, config::Config as SerialConfig};
use stm32f4xx_hal::watchdog::IndependentWatchdog;
use stm32f4xx_hal::{Listen, prelude::*, rcc};
use wsg_bridge_fw::can::{BusOffPolicy, CanBus, NoCan};
use wsg_bridge_fw::gripper::{Uart, UartBuffers, UartLine};
use wsg_bridge_fw::handler::Owned;
use wsg_bridge_fw::io::{HalInputs, HalOutputs};
use wsg_bridge_fw::plc::{Interrupts, RtuBuffers, RtuPort, RtuUart};
use wsg_bridge_fw::registers::Record;
use wsg_bridge_fw::storage::NoFlash;
use wsg_bridge_fw::tick::Tick;
use wsg_bridge_fw::{Board, BoardId, BusConfig, Config, Format, GripperLine, PlcBus, ResetCause, Station};

/// The settings of this image. By default, the PLC uses wires and Modbus RTU.
const CONFIG: Config = Config::DEFAULT;
// The set-up below supports only these settings. No other code checks a constant.
const _: () = assert!(matches!(CONFIG.gripper_line, GripperLine::Serial));
const _: () = assert!(matches!((CONFIG.plc_bus, CONFIG.bus.format), (PlcBus::Modbus, Format::Even1)));

/// Shared by the handlers and the main loop.
static GRIPPER: UartBuffers = UartBuffers::new();
static BUS: RtuBuffers = RtuBuffers::new();
static SERVICE: RtuBuffers = RtuBuffers::new();
static TICK: Tick<84_000> = Tick::new();

/// The UARTs, used only by their handlers after the start.
static GRIPPER_UART: Owned<Serial<pac::USART1>> = Owned::new();
static BUS_UART: Owned<(Serial<pac::UART4>, Pin<'A', 8, Output>)> = Owned::new();
static SERVICE_UART: Owned<Serial<pac::USART2>> = Owned::new();

/// The main loop's end of a line. It triggers the line's handler.
struct Line(Interrupt);

impl Uart for Line {
    fn pend(&mut self) {
        NVIC::pend(self.0);
    }

    fn is_idle(&mut self) -> bool {
        // SAFETY: reading the status has no side effect.
        unsafe { (*pac::USART1::ptr()).sr().read().tc().bit() }
    }
}

impl RtuUart for Line {
    fn pend(&mut self) {
        NVIC::pend(self.0);
    }

    fn now_us(&mut self) -> u32 {
        now_us()
    }
}

fn now_us() -> u32 {
    cortex_m::interrupt::free(|_| TICK.now_us(SYST::get_current(), SCB::is_pendst_pending()))
}

/// The main loop's access to the hardware, apart from wires and lines.
struct Hardware {
    led: Pin<'A', 5, Output>,
    watchdog: IndependentWatchdog,
}

/// Enables the handler of a UART, which `main` has set up.
fn unmask(interrupt: Interrupt) {
    // SAFETY: no critical section depends on this interrupt being masked.
    unsafe { NVIC::unmask(interrupt) };
}

impl wsg_bridge_fw::Hardware for Hardware {
    type Can = NoCan;
    type Flash = NoFlash;

    fn delivered() -> Record {
        CONFIG.record()
    }

    fn start_gripper(&mut self) {
        unmask(Interrupt::USART1);
    }

    fn start_service(&mut self) {
        SERVICE.start(&BusConfig::SERVICE);
        unmask(Interrupt::USART2);
    }

    fn start_bus(&mut self, config: &Config) {
        BUS.start(&config.bus);
        unmask(Interrupt::UART4);
    }

    fn now_ms(&mut self) -> u32 {
        TICK.now_ms()
    }

    fn indicate(&mut self, is_lit: bool) {
        self.led.set_state(is_lit.into());
    }

    fn feed_watchdog(&mut self) {
        self.watchdog.feed();
    }

    fn sleep(&mut self, now_ms: u32, _: bool) {
        cortex_m::interrupt::free(|_| {
            if TICK.now_ms() == now_ms && !GRIPPER.has_received() {
                cortex_m::asm::wfi();
            }
        });
    }
}

#[entry]
fn main() -> ! {
    static mut STATION: Station<NoCan> = Station::without_profibus(CanBus::new(NoCan, BusOffPolicy::DEFAULT));
    let (Some(mut core), Some(device)) = (cortex_m::Peripherals::take(), pac::Peripherals::take()) else {
        SCB::sys_reset()
    };
    let mut watchdog = IndependentWatchdog::new(device.IWDG);
    watchdog.start(100.millis());
    let mut rcc = device.RCC.freeze(rcc::Config::hsi().sysclk(84.MHz()));

    // The wires, in the order of `Inputs` and `Outputs`. Outputs are low from here on.
    let (a, b) = (device.GPIOA.split(&mut rcc), device.GPIOB.split(&mut rcc));
    let c = device.GPIOC.split(&mut rcc);
    macro_rules! inputs { ($($pin:expr),*) => { HalInputs::new([$($pin.into_pull_down_input().erase()),*]) } }
    macro_rules! outputs { ($($pin:expr),*) => { HalOutputs::new([$($pin.into_push_pull_output().erase()),*]) } }
    let inputs = inputs!(c.pc0, c.pc1, c.pc2, c.pc3, c.pc4, c.pc5, c.pc6, c.pc7);
    let outputs = outputs!(b.pb0, b.pb1, b.pb2, b.pb8, b.pb9, b.pb10, b.pb12);
    let led = a.pa5.into_push_pull_output();

    // The clock in milliseconds and microseconds.
    core.SYST.set_reload(Tick::<84_000>::RELOAD);
    core.SYST.clear_current();
    core.SYST.set_clock_source(cortex_m::peripheral::syst::SystClkSource::Core);
    core.SYST.enable_interrupt();
    core.SYST.enable_counter();

    // The UARTs: 8E1 for the bus, 115 200 bit/s and 8N1 for the others. The rates are constants, because the HAL divides by
    // them.
    let even = SerialConfig::default().baudrate(CONFIG.bus.baud.bps()).parity_even().wordlength_9();
    let gripper = Serial::new(device.USART1, (a.pa9, a.pa10), SerialConfig::default(), &mut rcc);
    let bus = Serial::new(device.UART4, (a.pa0, a.pa1), even, &mut rcc);
    let service = Serial::new(device.USART2, (a.pa2, a.pa3), SerialConfig::default(), &mut rcc);
    let driver_enable = a.pa8.into_push_pull_output();
    let (Ok(mut gripper), Ok(mut bus), Ok(mut service)) = (gripper, bus, service) else { SCB::sys_reset() };
    gripper.listen(Event::RxNotEmpty);
    bus.listen(Event::RxNotEmpty);
    service.listen(Event::RxNotEmpty);
    GRIPPER_UART.give(gripper);
    BUS_UART.give((bus, driver_enable));
    SERVICE_UART.give(service);

    let board = Board {
        hardware: Hardware { led, watchdog },
        id: BoardId { name: "my bridge", serial: 0 },
        wires: (inputs, outputs),
        gripper: UartLine::new(Line(Interrupt::USART1), &GRIPPER),
        bus: &mut RtuPort::new(Line(Interrupt::UART4), &BUS),
        service: &mut RtuPort::new(Line(Interrupt::USART2), &SERVICE),
        flash: &mut NoFlash,
    };
    wsg_bridge_fw::run(board, STATION, ResetCause::Unknown)
}

/// Enables the interrupts that a handler needs next.
fn expect<U: Listen<Event = Event>>(uart: &mut U, next: Interrupts) {
    uart.listen_only(Event::RxNotEmpty);
    if next.transmit_empty {
        uart.listen(Event::TxEmpty);
    }
    if next.transmission_complete {
        uart.listen(Event::TransmissionComplete);
    }
}

#[interrupt]
fn USART1() {
    GRIPPER_UART.with(|uart| {
        let transmit_empty = GRIPPER.serve(uart);
        expect(uart, Interrupts { transmit_empty, transmission_complete: false });
    });
}

#[interrupt]
fn UART4() {
    BUS_UART.with(|(uart, driver)| {
        // Enable the driver before the first byte and disable it when no data is left. The library ignores an echo.
        let before = BUS.interrupts();
        driver.set_state((before.transmit_empty || before.transmission_complete).into());
        let next = BUS.serve(uart, now_us());
        driver.set_state((next.transmit_empty || next.transmission_complete).into());
        expect(uart, next);
    });
}

#[interrupt]
fn USART2() {
    SERVICE_UART.with(|uart| {
        let next = SERVICE.serve(uart, now_us());
        expect(uart, next);
    });
}

#[exception]
fn SysTick() {
    TICK.count();
}

/// A reset sets every output low and restarts the bridge from a known state. Faults and unexpected interrupts are handled like
/// a panic.
#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    SCB::sys_reset()
}

// SAFETY: the handler uses no state of the interrupted program.
#[exception(trampoline = false)]
unsafe fn HardFault() -> ! {
    SCB::sys_reset()
}

// SAFETY: as above.
#[exception]
unsafe fn DefaultHandler(_: i16) -> ! {
    SCB::sys_reset()
}
