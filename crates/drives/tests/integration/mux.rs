//! Two TMCL lanes on one bus, each with a simulated TMCM-171 of its own identifiers.

use polepair_core::axis::{
    AxisCommands, AxisDirectory, AxisRequests, AxisScales, AxisText, AxisTraffic, Command, Verb,
};
use polepair_core::error::{Outcome, Unsupported};
use polepair_core::lane::{BoxedDriver, Lane};
use polepair_core::medium::{Can, Frame};
use polepair_core::mux::{BoxedLane, Mux};
use polepair_core::profile::ParameterId;
use polepair_core::proto::tmcl::{Tmcl, TmclCan};
use polepair_core::proto::{HostOptions, Protocol};
use polepair_core::station::{AxisIndex, Host, Station, Ticket, Timed};
use polepair_core::time::Instant;
use polepair_drives::tmcm17x::Tmcm17x;
use polepair_drives::{DeviceOptions, Family};

type Tmcm171Device = <Tmcm17x as Family>::Device;

const OPTIONS: HostOptions = HostOptions::new(250_000);

fn make_lane(address: u32, host: u32) -> BoxedLane {
    let profile = Tmcm17x::profiles()[0];
    let driver: BoxedDriver<_, _> = Box::new(TmclCan::create_driver(profile, address));
    let options = HostOptions { host_address: Some(host), ..OPTIONS };
    Box::new(Lane::<Can, <TmclCan as Protocol>::Host>::new(
        TmclCan::create_host(&options, &[]),
        [driver],
    ))
}

/// A module that was set over its serial end to use other identifiers.
fn make_device(can_id: i32, reply_id: i32) -> Tmcm171Device {
    let options = DeviceOptions {
        address: None,
        wires: &["tmcl"],
        standard: None,
        untimed: true,
        seed: 1,
        extra: &[],
    };
    let mut device = Tmcm17x::create_device(Tmcm17x::profiles()[0], &options).unwrap();
    for (parameter, value) in [(71, can_id), (70, reply_id)] {
        let text = std::format!("SGP {parameter}, 0, {value}");
        let driver = Tmcl::create_driver(Tmcm17x::profiles()[0], 1);
        let request = polepair_core::axis::RequestEncoder::parse_request(&driver, &text).unwrap();
        let mut out = [0; 16];
        let len = Tmcl::create_host(&OPTIONS, &[1]).encode_request(&request, &mut out);
        let now = Instant::ZERO.plus_ms(100);
        Station::<polepair_core::medium::Stream>::handle_input(&mut device, now, &out[..len]);
        let reply = Station::<polepair_core::medium::Stream>::poll_transmit(
            &mut device,
            now,
            &mut [0; 520],
        );
        assert!(reply.is_some());
    }
    device
}

/// Delivers everything that is sent within this time.
fn run(
    mux: &mut Mux,
    devices: &mut [Tmcm171Device],
    from: Instant,
    ms: u32,
) -> Vec<(Ticket, Outcome)> {
    let (mut now, mut ends) = (from, Vec::new());
    while now < from.plus_ms(ms) {
        for device in &mut *devices {
            device.handle_timeout(now);
            let mut frame = Frame::default();
            while Station::<Can>::poll_transmit(device, now, &mut frame).is_some() {
                mux.handle_input(now, &frame);
            }
        }
        mux.handle_timeout(now);
        let mut frame = Frame::default();
        while mux.poll_transmit(now, &mut frame).is_some() {
            for device in &mut *devices {
                Station::<Can>::handle_input(device, now, &frame);
            }
        }
        ends.extend(core::iter::from_fn(|| mux.poll_outcome()));
        now = now.plus_ms(1);
    }
    ends
}

#[test]
fn each_axis_is_reached_through_its_own_lane() {
    let mut mux = Mux::new([make_lane(0x11, 0x21), make_lane(0x12, 0x22)]).unwrap();
    assert_eq!((mux.axis_count(), mux.line().bit_rate), (2, 250_000));
    assert_eq!(mux.address(AxisIndex(1)), Some(0x12));
    let mut devices = [make_device(0x11, 0x21), make_device(0x12, 0x22)];
    let now = Instant::ZERO.plus_ms(200);
    for (axis, text) in [(0, "SAP 4, 0, 111"), (1, "SAP 4, 0, 222")] {
        mux.send_text(now, Ticket(axis.into()), AxisIndex(axis), text).unwrap();
    }
    assert_eq!(run(&mut mux, &mut devices, now, 50).len(), 2);
    let now = now.plus_ms(100);
    for axis in 0..2 {
        mux.send_text(now, Ticket(axis.into()), AxisIndex(axis), "GAP 4").unwrap();
    }
    let mut ends = run(&mut mux, &mut devices, now, 50);
    ends.sort_by_key(|(ticket, _)| ticket.0);
    assert_eq!(ends, [(Ticket(0), Outcome::Done(111)), (Ticket(1), Outcome::Done(222))]);
    assert_eq!(mux.counters().answered, 4);
}

#[test]
fn one_axis_turns_and_the_other_does_not() {
    let mut mux = Mux::new([make_lane(0x11, 0x21), make_lane(0x12, 0x22)]).unwrap();
    let mut devices = [make_device(0x11, 0x21), make_device(0x12, 0x22)];
    let now = Instant::ZERO.plus_ms(200);
    let turn = Command { velocity: Some(10.0), ..Command::new(Verb::Velocity) };
    assert_eq!(mux.command(now, Ticket(1), AxisIndex(1), turn), Err(Unsupported::NotArmed));
    mux.set_armed(AxisIndex(1), true);
    mux.command(now, Ticket(1), AxisIndex(1), turn).unwrap();
    let ends = run(&mut mux, &mut devices, now, 2000);
    assert!(matches!(ends[..], [(Ticket(1), Outcome::Done(_))]), "{ends:?}");
    let speeds = devices.map(|mut device| {
        polepair_drives::surroundings::SurroundingsControl::ground_truth(
            &mut device,
            now.plus_ms(2000),
        )
        .velocity
    });
    assert!(speeds[0].abs() < 0.1 && (speeds[1] - 10.0).abs() < 1.0, "{speeds:?}");
}

#[test]
fn lanes_that_cannot_share_a_wire_are_refused() {
    assert!(Mux::new([]).is_none());
    let other = HostOptions { bit_rate: 500_000, ..OPTIONS };
    let driver: BoxedDriver<_, _> = Box::new(TmclCan::create_driver(TmclCan::generic_profile(), 3));
    let other: BoxedLane = Box::new(Lane::<Can, <TmclCan as Protocol>::Host>::new(
        TmclCan::create_host(&other, &[]),
        [driver],
    ));
    assert!(Mux::new([make_lane(0x11, 0x21), other]).is_none());
    let mux = Mux::new([make_lane(0x11, 0x21)]).unwrap();
    assert_eq!(mux.address(AxisIndex(1)), None);
    assert_eq!(mux.to_si(AxisIndex(1), ParameterId(0), 1), None);
}
