//! A drive that was saved, reset and restored is the same in all registers: docs/troubleshooting/flash-wear.md.

use polepair::settings::{AxisSettings, is_setting, is_unnamed_setting};
use polepair::{LocalAxis, connect_local};
use polepair_core::profile::{Access, ParameterId};

/// All registers that a host may write, by number.
fn registers(axis: &LocalAxis) -> Vec<(ParameterId, i64)> {
    let kept = (0..).map(ParameterId).zip(axis.profile().parameters);
    let kept = kept.filter(|(_, it)| it.access == Access::ReadWrite && it.encoding.is_number());
    kept.filter_map(|(id, _)| Some((id, axis.read(id).ok()?))).collect()
}

#[test]
fn saved_settings_restore_a_drive_on_both_wires() {
    for (url, mode) in [("sim:syntron-ts", 14), ("sim:syntron-ts-canopen", 20)] {
        let url = format!("{url}?time=virtual");
        let (first, second) =
            (connect_local(&url).expect("a link"), connect_local(&url).expect("a link"));
        let (first, second) = (&first.axes()[0], &second.axes()[0]);
        // Every setting gets a value that it did not have, as far as its limits let it.
        let parameters = (0..).map(ParameterId).zip(first.profile().parameters);
        let mut changed = 0;
        for (id, parameter) in parameters {
            let is_link = first.profile().link_settings.contains(&id);
            let is_kept = is_setting(parameter) || is_unnamed_setting(parameter);
            // The S-times are refused without ramps, and digits by their meanings.
            if !is_kept
                || is_link
                || parameter.name.contains("s-time")
                || !parameter.digits.is_empty()
            {
                continue;
            }
            let raw = if parameter.name == "control mode" {
                mode
            } else {
                parameter.max.min(i64::from(id.0) % 90 + 1)
            };
            changed += u32::from(first.write(id, raw, false).is_ok());
        }
        assert!(changed > 600, "{url}: {changed} settings were changed");
        let saved = AxisSettings::read(first, &mut |_, _| {}).expect("saved");
        assert!(saved.unnamed_len() > 440, "{url}: {} without a name", saved.unnamed_len());
        for round in 0..2 {
            let changes = saved.changes(second, &mut |_, _| {}).expect("compared");
            assert_eq!(changes.is_empty(), round == 1, "{url}: {changes:?}");
            for write in saved.writes(second, &changes).expect("ordered") {
                second.write(write.id, write.raw, false).expect("written");
            }
        }
        assert_eq!(registers(first), registers(second), "{url}");
    }
}
