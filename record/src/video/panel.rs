//! Titles, captions and the plot around the pictures of a video.

use super::canvas::{Canvas, Fonts, LEFT, MIDDLE, RIGHT, Style};
use super::{Played, Result, VideoError};
use crate::style::{BLUE, LABEL_SHOWN_S, Rgb};
use supple::scenario::metrics::{BRIEF_S, SETTLE_S};
use supple::scenario::trace::{Event, EventKind, Frame};

const PAPER: Rgb = [255, 255, 255];
const INK: Rgb = [45, 52, 60];
const FAINT: Rgb = [110, 118, 128];
const GRID: Rgb = [226, 230, 234];
const ALARM: Rgb = [190, 40, 20];

/// Heights of the strip of titles and of the plot, as shares of the video's height.
const SHARES: [f32; 2] = [0.08, 0.27];

/// The parts of every frame but the pictures.
pub(super) struct Panel<'a> {
    fonts: Fonts,
    /// Number of pixels per pixel of a video of 540 pixels in height.
    unit: f32,
    size: [usize; 2],
    /// The frame at time zero, without pictures.
    base: Canvas,
    frame: Canvas,
    title: &'a str,
    curves: Vec<Curve<'a>>,
    /// Edges of the plotted area: left, top, right, bottom \[px\].
    area: [f32; 4],
    /// Ends of the axes of time \[s\] and of the deviation [m/s].
    ends: [f32; 2],
}

/// The curve and the captions of a robot.
struct Curve<'a> {
    colour: Rgb,
    /// Time \[s\] and deviation [m/s] of each frame.
    points: Vec<[f32; 2]>,
    events: &'a [Event],
}

impl<'a> Panel<'a> {
    pub(super) fn new(size: [usize; 2], title: &'a str, robots: &[Played<'a>]) -> Result<Self> {
        let fonts = Fonts::new().map_err(|error| VideoError::Encode(error.into()))?;
        let [width, height] = size.map(|length| length as f32);
        let unit = height / 540.0;
        let curve = |(robot, trace): &Played<'a>| Curve {
            colour: robot.tint.unwrap_or(BLUE),
            points: deviation(&trace.frames),
            events: &trace.events,
        };
        let curves: Vec<Curve<'_>> = robots.iter().map(curve).collect();
        let points = || curves.iter().flat_map(|curve| &curve.points);
        let end_s = points().map(|point| point[0]).fold(0.1, f32::max);
        // A robot that starts at rest is far off its command at first, which would dwarf the rest.
        let from_s = (SETTLE_S as f32).min(0.25 * end_s);
        let highest = points().filter(|point| point[0] > from_s).map(|point| point[1]).fold(0.1, f32::max);
        let ends = [end_s, 1.1 * highest];
        let area = [56.0 * unit, height * (1.0 - SHARES[1]) + 34.0 * unit, width - 20.0 * unit, height - 26.0 * unit];
        let base = Canvas::new(size, PAPER);
        let mut panel = Panel { fonts, unit, size, frame: base.clone(), base, title, curves, area, ends };
        panel.draw_base(robots);
        Ok(panel)
    }

    /// Returns width and height of a robot's picture \[px\].
    pub(super) fn picture_size(&self) -> [usize; 2] {
        let ([width, height], count) = (self.size, self.curves.len().max(1));
        let strips = SHARES.map(|share| (share * height as f32) as usize);
        [(width - self.gap() * (count - 1)) / count, height - strips[0] - strips[1]]
    }

    /// Returns the frame at a time \[s\] with the pictures of the robots.
    pub(super) fn compose(&mut self, time_s: f64, pictures: &[Vec<u8>]) -> &[u8] {
        let mut frame = std::mem::replace(&mut self.frame, Canvas::new([0, 0], PAPER));
        frame.rgb.copy_from_slice(&self.base.rgb);
        let [width, height] = self.picture_size();
        let top = self.strip();
        let time = time_s as f32;
        for (index, (curve, picture)) in self.curves.iter().zip(pictures).enumerate() {
            let left = index * (width + self.gap());
            frame.paste([left, top], width, picture);
            if let Some(event) = curve.events.iter().rev().find(|event| is_shown(event, time_s)) {
                self.draw_caption(&mut frame, [left as f32, (top + height) as f32], width as f32, event);
            }
        }
        let style = self.style(17.0, FAINT, false);
        let place = [self.size[0] as f32 - 20.0 * self.unit, 29.0 * self.unit];
        frame.text(&self.fonts, place, RIGHT, style, &format!("{}   {time_s:5.1} s", self.title));
        for curve in self.curves.iter().rev() {
            let until = curve.points.partition_point(|point| point[0] < time + 1e-3);
            let inside = curve.points[..until].iter().filter(|point| point[1] <= self.ends[1]);
            let line: Vec<[f32; 2]> = inside.map(|point| self.at(*point)).collect();
            frame.lines(&line, 2.4 * self.unit, curve.colour);
            if let Some(last) = line.last() {
                frame.lines(&[*last, *last], 9.0 * self.unit, curve.colour);
            }
        }
        self.frame = frame;
        &self.frame.rgb
    }

    fn gap(&self) -> usize {
        (4.0 * self.unit) as usize
    }

    /// Returns the height of the strip of titles \[px\].
    fn strip(&self) -> usize {
        (SHARES[0] * self.size[1] as f32) as usize
    }

    fn style(&self, size: f32, colour: Rgb, bold: bool) -> Style {
        Style { size: size * self.unit, colour, bold }
    }

    /// Returns the place of a point of the plot \[px\].
    fn at(&self, [time_s, value]: [f32; 2]) -> [f32; 2] {
        let [left, top, right, bottom] = self.area;
        [left + (right - left) * time_s / self.ends[0], bottom + (top - bottom) * value / self.ends[1]]
    }

    fn draw_base(&mut self, robots: &[Played<'_>]) {
        let mut base = self.base.clone();
        let [left, top, right, bottom] = self.area;
        let unit = self.unit;
        let (fonts, small) = (&self.fonts, self.style(15.0, FAINT, false));
        for (index, (robot, _)) in robots.iter().enumerate() {
            let x = (index * (self.picture_size()[0] + self.gap())) as f32 + 16.0 * unit;
            let style = self.style(22.0, self.curves[index].colour, true);
            base.text(fonts, [x, 30.0 * unit], LEFT, style, robot.name);
        }
        let heading = format!("off the commanded velocity by [m/s], mean over {BRIEF_S} s");
        base.text(fonts, [16.0 * unit, top - 12.0 * unit], LEFT, self.style(15.0, INK, false), &heading);
        let events = robots.iter().flat_map(|(_, trace)| &trace.events);
        let disturbances = events.filter(|event| event.kind == EventKind::Disturbance).map(|event| event.time_s);
        let mut disturbances: Vec<f64> = disturbances.collect();
        disturbances.dedup();
        for time_s in disturbances {
            let x = self.at([time_s as f32, 0.0])[0];
            base.lines(&[[x, top], [x, bottom]], 1.5 * unit, [240, 190, 160]);
        }
        for (value, text) in ticks(self.ends[1], 4) {
            let y = self.at([0.0, value])[1];
            base.rectangle([left, y], [right, y + unit.max(1.0)], GRID, 1.0);
            base.text(fonts, [left - 8.0 * unit, y + 5.0 * unit], RIGHT, small, &text);
        }
        for (time_s, text) in ticks(self.ends[0], 10) {
            let x = self.at([time_s, 0.0])[0];
            let text = if time_s == 0.0 { "0 s".to_owned() } else { text };
            base.text(fonts, [x, bottom + 19.0 * unit], MIDDLE, small, &text);
        }
        self.base = base;
    }

    fn draw_caption(&self, frame: &mut Canvas, [left, bottom]: [f32; 2], width: f32, event: &Event) {
        let unit = self.unit;
        let is_alarm = matches!(event.kind, EventKind::Fall | EventKind::Fault);
        let style = self.style(16.0, if is_alarm { ALARM } else { INK }, false);
        let mut text = event.text.clone();
        while self.fonts.width(&text, style) > width - 44.0 * unit && text.pop().is_some() {}
        let end = left + 32.0 * unit + self.fonts.width(&text, style);
        frame.rectangle([left + 12.0 * unit, bottom - 40.0 * unit], [end, bottom - 12.0 * unit], PAPER, 0.8);
        let place = [left + 22.0 * unit, bottom - 20.5 * unit];
        frame.text(&self.fonts, place, LEFT, style, &text);
    }
}

/// Returns true if the caption of an event is shown: that of a fall stays.
fn is_shown(event: &Event, time_s: f64) -> bool {
    let lasts = matches!(event.kind, EventKind::Fall | EventKind::Fault);
    event.time_s <= time_s + 1e-6 && (lasts || time_s < event.time_s + LABEL_SHOWN_S)
}

/// Returns time \[s\] and deviation [m/s] of frames: the size of the horizontal velocity minus its command, heading frame, as the
/// mean over the last [`BRIEF_S`].
fn deviation(frames: &[Frame]) -> Vec<[f32; 2]> {
    let error = |frame: &Frame| {
        [frame.velocity_in_heading[0] - frame.command.forward, frame.velocity_in_heading[1] - frame.command.left]
    };
    let value = |index: usize| {
        let from_s = frames[index].time_s - BRIEF_S + 1e-6;
        let last = frames[..=index].iter().rev().take_while(|frame| frame.time_s > from_s);
        let add = |([x, y], count): ([f64; 2], f64), [dx, dy]: [f64; 2]| ([x + dx, y + dy], count + 1.0);
        let ([forward, left], count) = last.map(error).fold(([0.0; 2], 0.0), add);
        [frames[index].time_s as f32, (forward.hypot(left) / count) as f32]
    };
    (0..frames.len()).map(value).collect()
}

/// Returns the ticks of an axis from zero, `most` or fewer above zero, with their texts.
fn ticks(end: f32, most: usize) -> Vec<(f32, String)> {
    let steps = (-2..4).flat_map(|power| [1.0, 2.0, 5.0].map(|digit| (digit * 10_f32.powi(power), power)));
    let (step, power) = steps.into_iter().find(|(step, _)| end / step <= most as f32).unwrap_or((end, 0));
    let decimals = usize::from(power < 0) * power.unsigned_abs() as usize;
    let count = (end / step) as usize;
    (0..=count).map(|k| (k as f32 * step, format!("{:.decimals$}", k as f32 * step))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use supple::task::Command;

    #[test]
    fn deviation_is_a_brief_mean_without_the_command() {
        let frame = |k: u32| Frame {
            time_s: f64::from(k) * 0.05,
            velocity_in_heading: [0.5, if k >= 5 { 0.4 } else { 0.0 }, 0.0],
            command: Command::velocity(0.5, 0.0, 0.0),
            ..Frame::default()
        };
        let frames: Vec<Frame> = (0..10).map(frame).collect();
        let values: Vec<f32> = deviation(&frames).iter().map(|point| point[1]).collect();
        // One of the two frames of 0.1 s is off by 0.4 m/s, then both.
        let expected = [0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.4, 0.4, 0.4, 0.4];
        assert!(values.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{values:?}");
    }

    #[test]
    fn ticks_are_round_numbers() {
        let texts = |end, most| ticks(end, most).into_iter().map(|(_, text)| text).collect::<Vec<_>>();
        assert_eq!(texts(0.55, 3), ["0.0", "0.2", "0.4"]);
        assert_eq!(texts(8.0, 10), ["0", "1", "2", "3", "4", "5", "6", "7", "8"]);
        assert_eq!(texts(0.12, 3), ["0.00", "0.05", "0.10"]);
    }
}
