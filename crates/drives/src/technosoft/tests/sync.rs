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

/// A master's messages move a slave in gear, and no other drive.
#[test]
fn a_master_of_a_gear_moves_its_slave() {
    for (can, slave_id) in [("tmlcan", 2), ("technocan", 2), ("tmlcan", 1 << 8 | 2)] {
        let mut desks: Vec<DriveFixture> =
            (1..=3).map(|axis| DriveFixture::at(Some(axis), &[("can", can)])).collect();
        // Axis 2 is in group 2 too.
        desks[1].send_instruction(0x0840, &[2]);
        for fixture in &mut desks[..2] {
            fixture.axis_on();
        }
        desks[1].fixed(0x02AC, 0.5); // GEAR
        desks[1].send_instruction(0x5909, &[0xB7C5, 0x8705]); // MODE GS
        desks[1].update();
        desks[0].word(0x0311, slave_id); // SLAVEID
        desks[0].send_instruction(0x5909, &[0xFFFF, 0x0800]); // SGM
        desks[0].long(0x029E, 4000);
        desks[0].mode_pp();
        desks[0].update();
        let run = |desks: &mut Vec<DriveFixture>, ms: u32| {
            let mut frames = 0;
            for _ in 0..ms {
                for fixture in &mut *desks {
                    fixture.wait(1);
                }
                let now = desks[0].now;
                let (master, slaves) = desks.split_first_mut().unwrap();
                let mut frame = Frame::default();
                while Station::<Can>::poll_transmit(&mut master.device, now, &mut frame).is_some() {
                    frames += 1;
                    for slave in &mut *slaves {
                        Station::<Can>::handle_input(&mut slave.device, now, &frame);
                    }
                }
            }
            frames
        };
        assert!(run(&mut desks, 2000) > 1900, "{can}");
        let counts: Vec<i32> = desks.iter_mut().map(|fixture| fixture.read_long(0x0228)).collect();
        assert!((counts[0] - 4000).abs() < 5, "{can}: {counts:?}");
        assert!((counts[1] - 2000).abs() < 5, "{can}: {counts:?}");
        assert_eq!((counts[2], desks[2].read_long(0x02AA)), (0, 0), "{can}: not its slave");
        desks[0].send_instruction(0x5909, &[0xF7FF, 0]); // RGM
        desks[0].update();
        assert_eq!(run(&mut desks, 50), 0, "{can}: no master any more");
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
