//! USB CDC ACM: bytes in, bytes out, no wait without a bound.
//!
//! The RP2040 does not report that a self-powered board was unplugged, so nothing here decides
//! whether the host is there: its heartbeat does, in the logic.

use embassy_executor::Spawner;
use embassy_futures::select::{Either, select};
use embassy_rp::peripherals::USB;
use embassy_rp::usb::Driver;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::pipe::Pipe;
use embassy_time::{Duration, Ticker, Timer, with_timeout};
use embassy_usb::UsbDevice;
use embassy_usb::class::cdc_acm::{CdcAcmClass, Receiver, Sender, State};
use portable_atomic::{AtomicBool, Ordering};
use static_cell::StaticCell;

use crate::interrupts::WAKE;
use crate::roll::{self, CHECK_IN};

type Bus = Driver<'static, USB>;

/// The most bytes in a packet: one less than USB's 64, so that none needs an empty one after it.
pub const PACKET: usize = 63;
/// A packet's bytes.
pub type Packet = heapless::Vec<u8, PACKET>;

/// Bytes from the host. While it is full the endpoint is not read: USB holds the host back.
pub static FROM_HOST: Pipe<CriticalSectionRawMutex, 1024> = Pipe::new();
/// Packets to the host.
pub static TO_HOST: Channel<CriticalSectionRawMutex, Packet, 4> = Channel::new();
/// The host configured the device anew, or let it go.
static LINK_LOST: AtomicBool = AtomicBool::new(false);

/// How long the host may take to fetch a packet; events are sent again anyway.
const WRITE_TIMEOUT: Duration = Duration::from_millis(100);

/// Whether the link was cut since the last call.
pub fn take_link_lost() -> bool {
    LINK_LOST.swap(false, Ordering::Relaxed)
}

#[embassy_executor::task]
async fn device(mut device: UsbDevice<'static, Bus>) -> ! {
    // The device's own work and the check-ins share this task: if one hangs, so does the other.
    let mut roll_call = Ticker::every(CHECK_IN);
    let check_in = async {
        loop {
            roll::check_in(roll::DEVICE);
            roll_call.next().await;
        }
    };
    match select(device.run(), check_in).await {
        Either::First(never) | Either::Second(never) => never,
    }
}

#[embassy_executor::task]
async fn receive(mut from: Receiver<'static, Bus>) -> ! {
    let mut packet = [0; 64];
    loop {
        roll::check_in(roll::RECEIVE);
        match select(from.read_packet(&mut packet), Timer::after(CHECK_IN)).await {
            Either::First(Ok(length)) => {
                // Waits only while the logic has not taken the bytes before; if it never does, the
                // logic is missing at the roll call, and so is this task.
                FROM_HOST
                    .write_all(packet.get(..length).unwrap_or_default())
                    .await;
                WAKE.signal(());
            }
            Either::First(Err(_)) => {
                LINK_LOST.store(true, Ordering::Relaxed);
                WAKE.signal(());
                // Until the host is back; looked at again in bounded time.
                let _ = with_timeout(CHECK_IN, from.wait_connection()).await;
            }
            Either::Second(()) => {}
        }
    }
}

#[embassy_executor::task]
async fn send(mut to: Sender<'static, Bus>) -> ! {
    loop {
        roll::check_in(roll::SEND);
        let Either::First(packet) = select(TO_HOST.receive(), Timer::after(CHECK_IN)).await else {
            continue;
        };
        match with_timeout(WRITE_TIMEOUT, to.write_packet(&packet)).await {
            Ok(Ok(())) => {}
            Ok(Err(_)) => Timer::after(Duration::from_millis(1)).await,
            Err(_) => {
                defmt::warn!(
                    "the host did not fetch a packet in {=u64} ms",
                    WRITE_TIMEOUT.as_millis()
                );
                TO_HOST.clear();
            }
        }
        WAKE.signal(());
    }
}

/// Starts the device and its tasks.
pub fn start(spawner: Spawner, driver: Bus, serial: &'static str) {
    static CONFIGURATION: StaticCell<[u8; 128]> = StaticCell::new();
    static BOS: StaticCell<[u8; 32]> = StaticCell::new();
    static CONTROL: StaticCell<[u8; 64]> = StaticCell::new();
    static STATE: StaticCell<State> = StaticCell::new();
    // pid.codes' number for private testing; a series needs one of its own.
    let mut config = embassy_usb::Config::new(0x1209, 0x0001);
    config.manufacturer = Some("Cannula");
    config.product = Some("Cannula motion board");
    config.serial_number = Some(serial);
    let mut builder = embassy_usb::Builder::new(
        driver,
        config,
        CONFIGURATION.init([0; 128]),
        BOS.init([0; 32]),
        &mut [],
        CONTROL.init([0; 64]),
    );
    let class = CdcAcmClass::new(&mut builder, STATE.init(State::new()), 64);
    let (to, from) = class.split();
    // Each task has one place, taken here once: none of these can fail.
    let _ = device(builder.build()).map(|task| spawner.spawn(task));
    let _ = receive(from).map(|task| spawner.spawn(task));
    let _ = send(to).map(|task| spawner.spawn(task));
}
