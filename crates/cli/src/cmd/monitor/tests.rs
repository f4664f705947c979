//! The screen as a person sees it, of simulated drives in virtual time.

use std::time::Duration;

use polepair::axis::{StopProgress, StopSupervisor, WireAirtime};
use polepair::{Connector, simulate};
use polepair_core::profile::Signal;
use polepair_drives::surroundings::Act;
use polepair_link::{ServeThread, pty::Pty};
use ratatui_core::backend::TestBackend;
use ratatui_core::buffer::Buffer;
use ratatui_core::style::{Color, Modifier};
use ratatui_core::terminal::Terminal;
use ratatui_crossterm::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

use super::draw::{Theme, draw_monitor};
use super::local::{LocalSource, Polling};
use super::model::Monitor;
use super::source::{AxisActivity, MonitorSource as _};
use super::view::{KeyOutcome, View};
use crate::tap_queue::TapQueue;

const PERIOD: Duration = Duration::from_millis(100);

/// A view of a link, as a person has it before them.
struct TestScreen {
    monitor: Monitor<LocalSource>,
    view: View,
    terminal: Terminal<TestBackend>,
}

impl TestScreen {
    fn new(url: &str, width: u16, height: u16) -> Self {
        let tap_queue = TapQueue::default();
        let taps = tap_queue.clone();
        let connector = Connector::default().with_taps(move |wire| taps.tap(wire));
        let link = connector.connect_local(url).expect("a link");
        let polling = Polling { period: PERIOD, completes_rounds: false };
        let monitor = Monitor::with_link(link, url, None, tap_queue, polling).expect("axes");
        let terminal = Terminal::new(TestBackend::new(width, height)).expect("a terminal");
        let mut screen = Self { monitor, view: View::default(), terminal };
        screen.wait(1);
        screen
    }

    /// Lets this many rounds of queries pass.
    fn wait(&mut self, rounds: u32) {
        for _ in 0..rounds {
            self.monitor.poll(&mut |_| ()).expect("a link");
            self.monitor.source.wait_answers();
            self.monitor.poll(&mut |_| ()).expect("a link");
            self.monitor.source.sleep(PERIOD);
        }
    }

    fn press(&mut self, code: KeyCode) -> KeyOutcome {
        self.view.handle_key(KeyEvent::new(code, KeyModifiers::NONE), &mut self.monitor)
    }

    fn type_in(&mut self, text: &str) {
        for letter in text.chars() {
            self.press(KeyCode::Char(letter));
        }
    }

    fn screen(&mut self) -> String {
        self.screen_in(Theme { colour: true })
    }

    fn screen_in(&mut self, theme: Theme) -> String {
        let Self { monitor, view, terminal } = self;
        let drawn = terminal.draw(|frame| draw_monitor(monitor, view, theme, frame.buffer_mut()));
        drawn.expect("a frame");
        terminal
            .backend()
            .to_string()
            .lines()
            .map(|line| format!("{}\n", line.trim_matches('"')))
            .collect()
    }

    /// Two axes on a port, of which only the first is there.
    fn half_deserted() -> (Self, ServeThread) {
        let rack = simulate::rack_of_words(&["tmcm-171:1"], 1).expect("a rack");
        let line = simulate::drive_lines(&rack, 1).expect("a line").remove(0);
        let pty = Pty::open(None).expect("a pseudo-terminal");
        let url = format!("tmcl+serial://{}?profile=tmcm-171#1,9", pty.path());
        let served = line.serve(Box::new(pty));
        (Self::new(&url, 120, 24), served)
    }

    fn simulate(&self, drive: usize, act: Act) {
        let link = self.monitor.source.link().expect("a link");
        assert!(link.simulation().expect("simulated").act(0, drive, act));
    }
}

fn one_bus() -> String {
    let folder = env!("CARGO_MANIFEST_DIR");
    format!("sim:{folder}/../../docs/examples/one-bus.toml?time=virtual")
}

#[test]
fn axes_and_frames_are_shown_whatever_the_size() {
    for (width, height) in [(80, 24), (120, 40), (60, 15), (40, 8), (1, 1)] {
        let mut entry = TestScreen::new("sim:tmcl?time=virtual&axes=2", width, height);
        let screen = entry.screen();
        assert_eq!(screen.lines().count(), usize::from(height));
        if width >= 60 {
            for wanted in
                ["STOP ALL: Esc", "position", "velocity", "0.0 rpm", "── frames", "q exit"]
            {
                assert!(screen.contains(wanted), "{width}x{height} lacks {wanted}:\n{screen}");
            }
        }
    }
}

#[test]
fn a_frame_has_its_bytes_its_meaning_and_what_changed() {
    let mut entry = TestScreen::new("sim:tmcl?time=virtual", 120, 30);
    entry.wait(3);
    let screen = entry.screen();
    let line = "< 02 01 64 06 00 00 00 00 6D   actual position = 0";
    assert!(screen.contains(line), "{screen}");
    let changes = |entry: &TestScreen| {
        let speeds = entry.monitor.traffic.rows().iter();
        speeds.filter(|row| row.text.starts_with("actual velocity") && row.changed > 0).count()
    };
    assert_eq!(changes(&entry), 0);
    let axis = entry.monitor.source.axes[0].axis.clone();
    axis.arm(true);
    axis.enable().expect("power");
    axis.velocity("600 rpm").expect("a speed");
    entry.wait(3);
    assert!(changes(&entry) > 0);
    entry.screen();
    let cells = entry.terminal.backend().buffer().content();
    let marked = cells.iter().any(|cell| cell.modifier.contains(Modifier::UNDERLINED));
    assert!(marked, "changed bytes are underlined");
}

#[test]
fn esc_stops_what_turns_and_says_how_far_that_came() {
    let mut entry = TestScreen::new("sim:tmcl?time=virtual&axes=2", 100, 24);
    let axis = entry.monitor.source.axes[1].axis.clone();
    axis.arm(true);
    axis.enable().expect("power");
    axis.velocity("600 rpm").expect("a speed");
    entry.wait(5);
    assert_eq!(entry.monitor.axes()[1].activity, AxisActivity::Turning);
    assert!(entry.screen().contains("turns"));
    assert!(entry.monitor.source.exit_notes()[0].contains("polepair stop 'sim:tmcl?"));
    // Not even a filter that is being typed keeps it from going out.
    entry.type_in("/q");
    assert_eq!(entry.press(KeyCode::Esc), KeyOutcome::Continue);
    assert!(!entry.view.typing);
    assert_eq!(
        entry.monitor.source.axes[1].stopping.as_ref().expect("a stop").progress(),
        &StopProgress::Sent
    );
    assert!(entry.screen().contains("stop sent"));
    for _ in 0..2_000 {
        entry.monitor.poll(&mut |_| ()).expect("a link");
        let class =
            |n: usize| entry.monitor.source.axes[n].stopping.as_ref().map(StopSupervisor::progress);
        if [class(0), class(1)] == [Some(&StopProgress::Standstill); 2] {
            break;
        }
        entry.monitor.source.sleep(Duration::from_millis(5));
    }
    let screen = entry.screen();
    assert!(screen.contains("1, 3: standing still"), "{screen}");
    assert!(entry.monitor.source.exit_notes().is_empty());
    entry.wait(2);
    assert_eq!(entry.monitor.axes()[1].signal(Signal::Velocity).expect("a speed").value, 0.0);
}

#[test]
fn a_stop_without_an_answer_is_not_called_one() {
    let (mut entry, _served) = TestScreen::half_deserted();
    entry.press(KeyCode::Esc);
    for watched in &mut entry.monitor.source.axes {
        let stopping = watched.stopping.as_mut().expect("a stop");
        let _ = stopping.wait(&mut WireAirtime::default(), Duration::from_secs(60));
    }
    let screen = entry.screen();
    assert!(screen.contains("9: NOT CONFIRMED, cut its power"), "{screen}");
    assert!(screen.contains("STOP FAILED") && screen.contains("1: standing still"), "{screen}");
    assert!(entry.monitor.source.exit_notes()[0].contains("axis 9 may not have stopped"));
}

#[test]
fn a_fault_comes_with_cause_and_remedy() {
    let mut entry = TestScreen::new("sim:tmcm-171?time=virtual", 80, 24);
    entry.simulate(0, Act::Supply(7.0));
    entry.wait(3);
    let screen = entry.screen();
    assert_eq!(entry.monitor.axes()[0].activity, AxisActivity::Fault, "{screen}");
    assert!(screen.contains("FAULT") && screen.contains("remedy"), "{screen}");
}

#[test]
fn an_axis_that_does_not_answer_keeps_no_other_waiting() {
    let (mut entry, _served) = TestScreen::half_deserted();
    entry.wait(3);
    let screen = entry.screen();
    assert_eq!(entry.monitor.axes()[0].activity, AxisActivity::Off, "{screen}");
    assert_eq!(entry.monitor.axes()[1].activity, AxisActivity::Silent, "{screen}");
    assert!(screen.contains("no answer") && screen.contains("silent"), "{screen}");
}

#[test]
fn frames_are_filtered_halted_and_gathered_by_kind() {
    let mut entry = TestScreen::new("sim:tmcl?time=virtual", 100, 24);
    entry.wait(5);
    entry.type_in("/Velocity");
    entry.press(KeyCode::Enter);
    let shown = entry.view.frames(&entry.monitor, 100);
    assert!(!shown.is_empty() && shown.iter().all(|row| row.text.contains("velocity")));
    entry.type_in(" ");
    let halted = entry.screen();
    entry.wait(2);
    assert!(entry.screen().contains("PAUSED"), "{halted}");
    let frames = |screen: &str| -> Vec<String> {
        screen.lines().filter(|line| line.contains("axis parameter")).map(str::to_owned).collect()
    };
    assert_eq!(frames(&halted), frames(&entry.screen()), "they stand still");
    entry.type_in(" /");
    entry.press(KeyCode::Enter);
    entry.type_in("t");
    let kinds = entry.view.kinds(&entry.monitor, 100);
    let velocity: Vec<_> =
        kinds.iter().filter(|kind| kind.last.text.contains("actual velocity")).collect();
    assert_eq!(velocity.len(), 2, "the question and the answer");
    assert_eq!((velocity[0].count, velocity[1].count), (8, 8));
    assert!(entry.screen().contains("the last of each kind"));
}

#[test]
fn every_protocol_of_a_bus_is_described_in_its_own_words() {
    let mut entry = TestScreen::new(&one_bus(), 120, 40);
    entry.wait(12);
    assert_eq!(entry.monitor.traffic.counts().1, 0, "no frame breaks its protocol");
    let (name, load) = entry.monitor.traffic.wires().next().expect("a wire");
    assert!(load.is_some_and(|load| load > 0.0 && load < 0.8), "{name} {load:?}");
    let screen = entry.screen();
    for word in ["2 spindle", "5 x", "97 gripper", "12 starboard", "% busy"] {
        assert!(screen.contains(word), "{word}:\n{screen}");
    }
    for protocol in ["canopen", "technocan", "tmcl", "thruster"] {
        let mut kinds = entry.monitor.traffic.kinds();
        assert!(kinds.any(|kind| kind.last.protocol == Some(protocol)), "{protocol}");
    }
}

#[test]
fn without_colours_nothing_is_shown_by_colour_alone() {
    let mut screen = TestScreen::new("sim:tmcl?time=virtual", 100, 24);
    let coloured = screen.screen();
    assert_eq!(screen.screen_in(Theme { colour: false }), coloured);
    let cells = screen.terminal.backend().buffer().content();
    assert!(cells.iter().all(|cell| cell.fg == Color::Reset));
}

#[test]
fn help_is_closed_by_the_key_that_opened_it_and_accepts_stops() {
    let mut screen = TestScreen::new("sim:tmcl?time=virtual", 80, 24);
    screen.type_in("?");
    assert!(screen.screen().contains("stop all axes of this view"));
    assert_eq!(screen.press(KeyCode::Char('q')), KeyOutcome::Continue);
    assert!(!screen.view.help);
    screen.type_in("?");
    screen.press(KeyCode::Esc);
    assert!(!screen.view.help && screen.monitor.source.axes[0].stopping.is_some());
    assert_eq!(screen.press(KeyCode::Char('q')), KeyOutcome::Leave);
}

/// Draws what `docs/images/monitor.svg` is made from:
/// `cargo test -p polepair-cli --lib the_picture -- --ignored`, then
/// `cargo xtask picture < target/monitor.txt > docs/images/monitor.svg`.
#[test]
#[ignore = "it writes a file"]
fn the_picture_of_the_guide() {
    let mut screen = TestScreen::new(&one_bus(), 104, 30);
    for (n, speed) in [(0, "1200 rpm"), (1, "300 rpm")] {
        let axis = screen.monitor.source.axes[n].axis.clone();
        axis.arm(true);
        axis.enable().expect("power");
        axis.velocity(speed).expect("a speed");
    }
    screen.simulate(3, Act::Supply(7.0));
    screen.wait(15);
    screen.monitor.url = "sim:docs/examples/one-bus.toml".to_owned();
    screen.press(KeyCode::Down);
    screen.press(KeyCode::Down);
    screen.press(KeyCode::Down);
    screen.wait(2);
    screen.screen();
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../target/monitor.txt");
    std::fs::write(path, coloured(screen.terminal.backend().buffer())).expect("a file");
}

/// The screen as escape sequences for a terminal.
fn coloured(buffer: &Buffer) -> String {
    let mut text = String::new();
    for row in buffer.content().chunks(usize::from(buffer.area.width)) {
        let mut last = "";
        for cell in row {
            let code = match (cell.fg, cell.modifier.contains(Modifier::DIM)) {
                (Color::Green, _) => "32",
                (Color::Magenta, _) => "35",
                (Color::Red, _) => "31",
                (Color::Cyan, _) => "36",
                (_, true) => "2",
                _ => "0",
            };
            // A blank looks alike in every colour.
            if code != last && cell.symbol() != " " {
                text.push_str(&format!("\x1b[{code}m"));
                last = code;
            }
            text.push_str(cell.symbol());
        }
        text.push('\n');
    }
    text
}
