//! `watch`: state and flags, and plots of width, speed and force, on the full screen.

use std::collections::VecDeque;
use std::io::{self, IsTerminal};
use std::time::{Duration, Instant};

use crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Style, Stylize};
use ratatui::symbols::Marker;
use ratatui::text::Line;
use ratatui::widgets::{Axis, Block, Chart, Dataset, GraphType, Paragraph, Wrap};
use wsg_protocol::session::Known;

use super::line::LOOK_MS;
use super::prompt::state_line;
use super::run::{self, Gripper, ProtocolCommands};
use super::trouble::Trouble;

/// Shortest interval between two updates of a value, in ms.
const UPDATE_MS: u16 = 50;
/// Interval between two redraws of the screen.
const DRAW_PERIOD: Duration = Duration::from_millis(100);
/// Time span of the plots in seconds.
const SHOWN_S: f64 = 30.0;

/// The data to show.
struct View {
    title: String,
    known: Known,
    is_connected: bool,
    samples: VecDeque<Sample>,
}

/// The values known at a time `at` in seconds.
struct Sample {
    at: f64,
    width: Option<f32>,
    speed: Option<f32>,
    force: Option<f32>,
}

impl View {
    fn new(title: String) -> Self {
        Self { title, known: Known::NOTHING, is_connected: false, samples: VecDeque::new() }
    }

    fn note(&mut self, at: f64, known: Known, is_connected: bool) {
        let Known { width, speed, force, .. } = known;
        self.samples.push_back(Sample { at, width, speed, force });
        while self.samples.front().is_some_and(|sample| sample.at < at - SHOWN_S) {
            self.samples.pop_front();
        }
        (self.known, self.is_connected) = (known, is_connected);
    }

    /// Returns the lines to plot for a value, each without a gap in time. A point is the time relative to now in seconds, and
    /// the value.
    fn lines(&self, value: impl Fn(&Sample) -> Option<f32>) -> Vec<Vec<(f64, f64)>> {
        let now = self.samples.back().map_or(0.0, |sample| sample.at);
        let point = |sample: &Sample| Some((sample.at - now, value(sample)?.into()));
        let points: Vec<_> = self.samples.iter().map(point).collect();
        let lines = points.split(Option::is_none).map(|line| line.iter().flatten().copied().collect());
        lines.filter(|line: &Vec<_>| !line.is_empty()).collect()
    }
}

/// Shows the gripper until `q`, Esc or Ctrl-C is pressed.
pub(crate) fn run<P: ProtocolCommands>(gripper: &mut Gripper<P>, title: String) -> Result<u8, Trouble> {
    if !io::stdout().is_terminal() {
        return Err(Trouble::Usage("`watch` requires a terminal; use `log` instead".to_owned()));
    }
    run::subscribe(gripper, UPDATE_MS);
    let mut terminal = ratatui::try_init()?;
    let _restored = Restore;
    let start = Instant::now();
    let mut view = View::new(title);
    let mut drawn: Option<Instant> = None;
    loop {
        if is_over()? {
            run::unsubscribe(gripper);
            return Ok(0);
        }
        gripper.next_update(LOOK_MS)?;
        if drawn.is_none_or(|drawn| drawn.elapsed() >= DRAW_PERIOD) {
            view.note(start.elapsed().as_secs_f64(), *gripper.known(), gripper.is_connected());
            terminal.draw(|frame| draw(frame, &view))?;
            drawn = Some(Instant::now());
        }
    }
}

/// Restores the terminal when dropped, even after an error.
struct Restore;

impl Drop for Restore {
    fn drop(&mut self) {
        // An error cannot be reported from here.
        let _ = ratatui::try_restore();
    }
}

/// Returns whether a pressed key ends the program.
fn is_over() -> io::Result<bool> {
    while event::poll(Duration::ZERO)? {
        if let Event::Key(key) = event::read()?
            && key.kind != KeyEventKind::Release
        {
            let is_control_c =
                key.modifiers.contains(KeyModifiers::CONTROL) && key.code == KeyCode::Char('c');
            if is_control_c || matches!(key.code, KeyCode::Char('q') | KeyCode::Esc) {
                return Ok(true);
            }
        }
    }
    Ok(false)
}

fn draw(frame: &mut Frame<'_>, view: &View) {
    let rows = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(2),
        Constraint::Fill(1),
        Constraint::Fill(1),
        Constraint::Fill(1),
    ]);
    let [title, state, width, speed, force] = rows.areas(frame.area());
    let keys = "  q: quit";
    frame.render_widget(Line::from(vec![view.title.as_str().bold(), keys.dim()]), title);
    let words = Paragraph::new(state_line(&view.known, view.is_connected)).wrap(Wrap { trim: true });
    frame.render_widget(words, state);
    let limits = view.known.limits;
    let stroke = limits.map(|limits| [0.0, limits.stroke]);
    let greatest = limits.map(|limits| [-limits.max_speed, limits.max_speed]);
    let nominal = limits.map(|limits| [0.0, limits.nominal_force]);
    plot(frame, width, "width, mm", Color::Cyan, stroke, &view.lines(|sample| sample.width));
    plot(frame, speed, "speed, mm/s", Color::Yellow, greatest, &view.lines(|sample| sample.speed));
    plot(frame, force, "force, N", Color::Magenta, nominal, &view.lines(|sample| sample.force));
}

/// Plots a value over time. The axis covers the gripper's range if known, and at least all values.
fn plot(
    frame: &mut Frame<'_>,
    area: Rect,
    title: &str,
    color: Color,
    range: Option<[f32; 2]>,
    lines: &[Vec<(f64, f64)>],
) {
    let numbers = || lines.iter().flatten().map(|point| point.1);
    let (lowest, highest) = (numbers().fold(0.0, f64::min), numbers().fold(1.0, f64::max));
    let [low, high] = range
        .filter(|[_, high]| high.is_finite())
        .map_or([lowest, highest], |[low, high]| [lowest.min(low.into()), highest.max(high.into())]);
    let style = Style::new().fg(color);
    let data = |line| Dataset::default().data(line).graph_type(GraphType::Line).marker(Marker::Braille);
    let data = lines.iter().map(|line| data(line).style(style)).collect();
    let times = Axis::default().bounds([-SHOWN_S, 0.0]).labels([format!("-{SHOWN_S} s"), "now".to_owned()]);
    let values = Axis::default().bounds([low, high]).labels([format!("{low:.0}"), format!("{high:.0}")]);
    let chart = Chart::new(data).x_axis(times).y_axis(values);
    frame.render_widget(chart.block(Block::bordered().title(title.to_owned())), area);
}

#[cfg(test)]
mod tests {
    use super::*;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use wsg_protocol::{GripperState, SystemFlags, SystemLimits};

    fn screen(view: &View) -> String {
        let mut terminal = Terminal::new(TestBackend::new(60, 24)).unwrap();
        terminal.draw(|frame| draw(frame, view)).unwrap();
        terminal.backend().to_string()
    }

    #[test]
    fn screen_shows_state_and_plots_with_the_grippers_ranges() {
        let mut view = View::new("tcp://192.168.1.20:1000".to_owned());
        assert!(screen(&view).contains("no connection"));
        let limits = SystemLimits {
            stroke: 110.0,
            min_speed: 5.0,
            max_speed: 420.0,
            min_acceleration: 100.0,
            max_acceleration: 5_000.0,
            min_force: 5.0,
            nominal_force: 80.0,
            overdrive_force: 120.0,
        };
        for tick in 0..200_u8 {
            let known = Known {
                limits: Some(limits),
                state: Some(GripperState::Gripping),
                flags: Some(SystemFlags::REFERENCED | SystemFlags::MOVING),
                width: Some(110.0 - f32::from(tick) / 2.0),
                speed: Some(-50.0),
                force: Some(0.0),
                ..Known::NOTHING
            };
            view.note(f64::from(tick) / 10.0, known, true);
        }
        let screen = screen(&view);
        for text in [
            "tcp://192.168.1.20:1000  q: quit",
            "GRIPPING  10.50 mm  -50.0 mm/s",
            "REFERENCED | MOVING",
            "width, mm",
        ] {
            assert!(screen.contains(text), "{text}\n{screen}");
        }
        for label in ["110", "420", "-420", "80", "-30 s", "now"] {
            assert!(screen.contains(label), "{label}\n{screen}");
        }
        let is_drawn = |character: char| ('\u{2801}'..='\u{28FF}').contains(&character);
        assert!(screen.chars().filter(|character| is_drawn(*character)).count() > 20, "{screen}");
    }

    #[test]
    fn plot_has_a_gap_while_no_value_is_known() {
        let mut view = View::new(String::new());
        let known = |width| Known { width: Some(width), ..Known::NOTHING };
        for (at, known, is_connected) in [
            (0.0, known(50.0), true),
            (1.0, known(40.0), true),
            (2.0, Known::NOTHING, false),
            (3.0, known(90.0), true),
        ] {
            view.note(at, known, is_connected);
        }
        assert_eq!(view.lines(|sample| sample.width), [vec![(-3.0, 50.0), (-2.0, 40.0)], vec![(0.0, 90.0)]]);
        assert!(view.lines(|sample| sample.force).is_empty());
        view.note(4.0, Known::NOTHING, false);
        assert!(screen(&view).contains("no connection"));
    }

    #[test]
    fn samples_older_than_the_plot_are_discarded() {
        let mut view = View::new(String::new());
        (0..1_000).for_each(|tick| view.note(f64::from(tick), Known::NOTHING, true));
        assert_eq!(view.samples.len(), 31);
    }
}
