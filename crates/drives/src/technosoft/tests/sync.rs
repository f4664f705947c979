//! One time for several drives.

use super::DriveFixture;
use super::Vec;
use polepair_core::medium::{Can, Frame};
use polepair_core::station::Station;

/// TML communication manual, chapter 5, example 4, with ten drives whose quartzes differ.
#[test]
fn ten_drives_keep_within_a_period_of_their_master() {
    for can in ["tmlcan", "technocan"] {
        let drift = ["0", "100", "-100", "50", "-50", "80", "-80", "30", "-30", "10"];
        let mut desks: Vec<DriveFixture> = drift
            .iter()
            .zip(1..)
            .map(|(ppm, axis)| DriveFixture::at(Some(axis), &[("clock-ppm", ppm), ("can", can)]))
            .collect();
        for (fixture, ahead) in desks.iter_mut().zip(0..) {
            fixture.long(0x02C0, ahead * 1000);
        }
        desks[0].send_instruction(0x1404, &[20, 0]);
        for ms in 0..60_000 {
            for fixture in &mut desks {
                fixture.wait(1);
            }
            let now = desks[0].now;
            let (master, slaves) = desks.split_first_mut().unwrap();
            let mut frame = Frame::default();
            while Station::<Can>::poll_transmit(&mut master.device, now, &mut frame).is_some() {
                for slave in &mut *slaves {
                    Station::<Can>::handle_input(&mut slave.device, now, &frame);
                }
            }
            if ms > 100 && ms % 777 == 0 {
                let times: Vec<i32> = desks.iter_mut().map(|d| d.read_long(0x02C0)).collect();
                assert!(times.iter().all(|t| (t - times[0]).abs() <= 1), "{can} {ms}: {times:?}");
            }
        }
    }
}

/// TML communication manual, chapter 3: on RS-485 only the host begins.
#[test]
fn a_master_of_time_is_silent_on_rs485() {
    for wire in ["rs485", "rs232"] {
        let mut master = DriveFixture::at(Some(1), &[("wire", wire), ("can", "tmlcan")]);
        master.send_instruction(0x1404, &[20, 0]);
        let (mut serial, mut frames) = (0, 0);
        let mut frame = Frame::default();
        for _ in 0..200 {
            master.wait(1);
            serial += master.sent().len();
            let now = master.now;
            while Station::<Can>::poll_transmit(&mut master.device, now, &mut frame).is_some() {
                frames += 1;
            }
        }
        assert_eq!(serial, 0, "{wire}");
        // A synchronisation and the time, every 20 ms.
        assert!((18..=20).contains(&frames), "{wire}: {frames}");
    }
}
