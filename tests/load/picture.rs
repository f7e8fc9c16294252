//! The load over time, as an SVG picture.

use crate::report::{Report, Second};

const WIDTH: f64 = 860.0;
const PANEL: f64 = 150.0;
const MARGIN: [f64; 2] = [70.0, 30.0];

/// A named curve over time.
struct Curve<'a> {
    name: &'a str,
    colour: &'a str,
    points: Vec<(f64, f64)>,
}

/// Latencies, throughput and memory, one panel each.
pub(crate) fn draw(report: &Report) -> String {
    let of_seconds = |name, colour, value: fn(&Second) -> f64| Curve {
        name,
        colour,
        points: report.seconds.iter().enumerate().map(|(t, s)| (t as f64, value(s))).collect(),
    };
    let of_samples = |name, colour, metric: &str, unit: f64| Curve {
        name,
        colour,
        points: report.samples.iter().map(|s| (s.time_s, s.values[metric] / unit)).collect(),
    };
    let mebibyte = f64::from(1 << 20);
    let panels = [
        (
            "latency of edits in ms, from when they were due",
            vec![
                of_seconds("largest", "#d55e00", |s| s.max_ms),
                of_seconds("median", "#0072b2", |s| s.median_ms),
            ],
        ),
        (
            "edits a second",
            vec![
                of_seconds("acknowledged", "#0072b2", |s| f64::from(s.n_made)),
                of_seconds("refused", "#d55e00", |s| f64::from(s.n_refused)),
                of_samples("waiting", "#565656", "sutura_edits_waiting", 1.0),
            ],
        ),
        (
            "memory in MiB",
            vec![
                of_samples("resident", "#0072b2", "process_resident_memory_bytes", mebibyte),
                of_samples("bodies", "#009e73", "sutura_body_bytes", mebibyte),
            ],
        ),
    ];
    let height = panels.len() as f64 * (PANEL + 2.0 * MARGIN[1]);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{height}\" \
         font-family=\"sans-serif\" font-size=\"12\"><rect width=\"100%\" height=\"100%\" \
         fill=\"white\"/>\n"
    );
    for (i, (title, curves)) in panels.iter().enumerate() {
        let top = i as f64 * (PANEL + 2.0 * MARGIN[1]) + MARGIN[1];
        panel(&mut svg, top, title, curves);
    }
    svg + "</svg>\n"
}

fn panel(svg: &mut String, top: f64, title: &str, curves: &[Curve<'_>]) {
    let all = || curves.iter().flat_map(|curve| &curve.points);
    let right = all().map(|point| point.0).fold(1.0, f64::max);
    let high = all().map(|point| point.1).fold(0.0, f64::max).max(1e-9) * 1.05;
    let inner = WIDTH - 2.0 * MARGIN[0];
    let x = |t: f64| MARGIN[0] + inner * t.max(0.0) / right;
    let y = |value: f64| top + PANEL * (1.0 - value / high);
    let mut line = |text: String| {
        svg.push_str(&text);
        svg.push('\n');
    };
    line(format!("<text x=\"{}\" y=\"{}\" font-size=\"14\">{title}</text>", MARGIN[0], top - 8.0));
    for tick in 0..=4 {
        let share = f64::from(tick) / 4.0;
        let (value, time) = (high * share, right * share);
        line(format!(
            "<path d=\"M{} {y1} H{}\" stroke=\"#ddd\"/><text x=\"{}\" y=\"{}\" \
             text-anchor=\"end\">{value:.0}</text><text x=\"{}\" y=\"{}\" \
             text-anchor=\"middle\">{time:.0} s</text>",
            MARGIN[0],
            MARGIN[0] + inner,
            MARGIN[0] - 6.0,
            y(value) + 4.0,
            x(time),
            top + PANEL + 16.0,
            y1 = y(value),
        ));
    }
    for (i, Curve { name, colour, points }) in curves.iter().enumerate() {
        let points: Vec<String> =
            points.iter().map(|&(t, value)| format!("{:.1},{:.1}", x(t), y(value))).collect();
        line(format!(
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>\
             <text x=\"{}\" y=\"{}\" fill=\"{colour}\">{name}</text>",
            points.join(" "),
            WIDTH - MARGIN[0] - 90.0 * (i + 1) as f64,
            top - 8.0,
        ));
    }
}
