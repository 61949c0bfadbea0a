//! The lens driver's driver against the chip's registers, and a capture through a lens.

mod common;

use common::script::{Record, capture_until_retract, run};
use common::{plan, stages};
use flankscope_bench::devices::max14574::{ADDRESS, Chip};
use flankscope_bench::devices::{DeviceConfig, DeviceFault};
use flankscope_controller::lens::{Lens, LensFault};
use flankscope_controller::max14574::Max14574;
use flankscope_protocol::*;
use flankscope_sim::i2c::I2cDevice;
use flankscope_sim::{Clock, I2cBus, Sim};
use std::cell::{Cell, RefCell};
use std::rc::Rc;

/// Runs a driver on a chip with this trouble; returns what the lens was driven with, from call to call.
fn driven<T: 'static>(
    trouble: Option<DeviceFault>,
    work: impl AsyncFnOnce(&mut Max14574<I2cBus>) -> T + 'static,
) -> (T, Vec<Option<u16>>) {
    let sim = Sim::new(Clock::Stepped);
    let bus = I2cBus::default();
    let out = Rc::new(RefCell::new(Vec::new()));
    let told = Rc::clone(&out);
    let chip = Chip::new(
        move |fault| trouble == Some(fault),
        move |counts| told.borrow_mut().push(counts),
    );
    bus.attach(ADDRESS, chip);
    let done = Rc::new(Cell::new(None));
    let finished = Rc::clone(&done);
    sim.spawn(async move {
        finished.set(Some(work(&mut Max14574::new(bus, 0b0011)).await));
    });
    sim.run();
    let out = out.borrow().clone();
    (done.take().expect("it ended"), out)
}

#[test]
fn every_count_reaches_the_lens_bit_by_bit_and_is_read_back() {
    let (results, out) = driven(None, async |lens| {
        let mut results = Vec::new();
        for counts in (0..1024).map(LensCounts) {
            results.push((lens.set(counts).await, lens.check(counts).await));
        }
        (results, lens.off().await)
    });
    assert_eq!(results.0, [(Ok(()), Ok(())); 1024]);
    assert!(results.1);
    let mut expected: Vec<_> = (0..1024).map(Some).collect();
    expected.push(None);
    assert_eq!(out, expected);
}

/// What goes over the wire, as the published drivers write it.
#[test]
fn the_bytes_are_those_of_the_register_table() {
    #[derive(Clone, Default)]
    struct Log(Rc<RefCell<Vec<Vec<u8>>>>);
    impl I2cDevice for Log {
        fn write(&mut self, bytes: &[u8]) -> bool {
            self.0.borrow_mut().push(bytes.to_vec());
            true
        }
        fn read(&mut self, answer: &mut [u8]) -> bool {
            // The test is over, no failure, the mode, the low bits (3), the high ones (0x87), no status.
            let asked = self.0.borrow().last().map(|bytes| bytes[0]);
            answer.fill(match asked {
                Some(0x03) => 0x03,
                Some(0x04) => 0xFF,
                Some(0x05..=0x08) => 0x87,
                _ => 0,
            });
            answer.len() == 1
        }
    }
    let sim = Sim::new(Clock::Stepped);
    let (bus, log) = (I2cBus::default(), Log::default());
    bus.attach(0x77, log.clone());
    sim.spawn(async move {
        let mut lens = Max14574::new(bus, 0b0001);
        assert_eq!(lens.set(LensCounts(0x87 << 2 | 3)).await, Ok(()));
        assert!(lens.off().await);
    });
    sim.run();
    let expected: [&[u8]; 12] = [
        &[0x03, 0x03, 0xFF],
        &[0x05, 0x87, 0x87, 0x87, 0x87, 0x02],
        &[0x09, 0x01],
        &[0x09],
        &[0x01],
        &[0x03],
        &[0x04],
        &[0x05],
        &[0x06],
        &[0x07],
        &[0x08],
        &[0x00],
    ];
    let log = log.0.borrow();
    assert_eq!(log[..12], expected);
    assert_eq!(log[12..], [[0x03, 0x00]]);
}

#[test]
fn what_is_wrong_with_a_lens_is_named() {
    for (trouble, fault, detail) in [
        (DeviceFault::LensSilent, Fault::LensSilent, 0x03),
        (DeviceFault::LensForgets, Fault::LensLost, 0x00),
        (DeviceFault::LensOpen, Fault::LensOpen, 0b0_1101),
        (DeviceFault::LensShort, Fault::LensShort, 0b10_1100),
        (DeviceFault::LensHot, Fault::LensHot, 0x10),
        (DeviceFault::LensNoBoost, Fault::LensVoltage, 0x04),
    ] {
        let (result, _) = driven(Some(trouble), async |lens| lens.set(LensCounts(516)).await);
        assert_eq!(result, Err(LensFault { fault, detail }), "{trouble:?}");
    }
    // Nobody there.
    let (fitted, out) = driven(Some(DeviceFault::LensSilent), async |lens| lens.off().await);
    assert!(!fitted && out.is_empty());
}

#[test]
fn a_test_of_the_connections_that_never_ends_is_a_silent_lens() {
    struct Stuck;
    impl I2cDevice for Stuck {
        fn write(&mut self, _: &[u8]) -> bool {
            true
        }
        fn read(&mut self, answer: &mut [u8]) -> bool {
            answer.fill(1);
            true
        }
    }
    let sim = Sim::new(Clock::Stepped);
    let bus = I2cBus::default();
    bus.attach(ADDRESS, Stuck);
    sim.spawn(async move {
        let fault = Fault::LensSilent;
        let set = Max14574::new(bus, 0b0011).set(LensCounts(516)).await;
        assert_eq!(set, Err(LensFault { fault, detail: 9 }));
    });
    sim.run();
}

fn focused() -> CapturePlan {
    CapturePlan {
        focus: Some(Focus {
            counts: LensCounts(541),
            settle: Microseconds(150_000),
        }),
        ..plan()
    }
}

/// Runs a plan on a controller with a lens; `spoil` is given when the first view is done.
fn captured(plan: CapturePlan, spoil: Option<DeviceFault>) -> Record {
    let devices = DeviceConfig {
        lens: true,
        ..DeviceConfig::default()
    };
    let view_done = |event: &Event| matches!(event, Event::ViewDone { .. });
    capture_until_retract(devices, plan, view_done, spoil)
}

#[test]
fn a_capture_goes_through_the_commanded_lens_and_leaves_it_off() {
    let record = captured(focused(), None);
    assert_eq!(record.faults(), []);
    // Off at power-up, on for the capture, off behind it.
    assert_eq!(record.notes.focused, [None, Some(541), None]);
    let frames = 3 * usize::from(focused().frames_per_view());
    assert_eq!(record.notes.exposures.len(), frames);
    // Nor does one who asks for none get any.
    assert_eq!(captured(plan(), None).notes.focused, [None]);
}

#[test]
fn a_lens_lost_on_the_way_ends_the_capture_by_name_with_the_head_out() {
    for (trouble, fault) in [
        (DeviceFault::LensSilent, Fault::LensSilent),
        (DeviceFault::LensForgets, Fault::LensLost),
        (DeviceFault::LensHot, Fault::LensHot),
        (DeviceFault::LensNoBoost, Fault::LensVoltage),
    ] {
        let record = captured(focused(), Some(trouble));
        let faults: Vec<_> = record
            .faults()
            .into_iter()
            .map(|(fault, _)| fault)
            .collect();
        assert_eq!(faults, [fault], "{trouble:?}");
        let frames = usize::from(focused().frames_per_view());
        let exposed = record.notes.exposures.len();
        assert_eq!(exposed, frames, "no light in the second view");
    }
}

#[test]
fn a_controller_without_a_lens_says_so_and_refuses_a_focus() {
    run(DeviceConfig::default(), |mut host, _| async move {
        let hello = Command::Hello {
            protocol: PROTOCOL_VERSION,
            schema: SCHEMA_HASH,
        };
        let Reply::Hello(identity) = host.order(hello).await else {
            panic!("refused")
        };
        assert!(!identity.lens);
        assert_eq!(host.order(stages()).await, Reply::Accepted);
        let refused = host.order(Command::LoadPlan(focused())).await;
        assert_eq!(refused, Reply::Refused(Refusal::NoLens));
        assert_eq!(host.order(Command::LoadPlan(plan())).await, Reply::Accepted);
        host
    });
}
