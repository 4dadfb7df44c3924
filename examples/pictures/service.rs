//! `docs/wire.csv` and `docs/load.csv`: what a particle costs, and how long a request waits.

#![expect(clippy::disallowed_methods, reason = "logarithms that place marks; no state of a world comes of them")]

use crate::chart::time;
use crate::csv::Recorded;
use crate::svg::{Anchor, Colour, Picture, Stroke};

/// What is done, its case, and its ways: their figure and how they are called.
type Group = (&'static str, &'static str, &'static [(&'static str, &'static str)]);

pub(crate) fn wire(wire: &Recorded) -> String {
    let mut picture = Picture::new(
        "CBOR costs a fraction of what JSON costs",
        "Time of a particle in double, from the request to the last byte, and how many times that of a raw socket with the same bytes.",
    );
    let groups: [Group; 3] = [
        (
            "Reading positions and velocities",
            "out",
            &[
                ("newton_euler: JSON rows", "JSON rows"),
                ("newton_euler: JSON columns", "JSON columns"),
                ("newton_euler: JSON columns, gzip", "JSON columns, gzip"),
                ("newton_euler: JSON columns, zstd", "JSON columns, zstd"),
                ("newton_euler: CBOR columns", "CBOR columns"),
            ],
        ),
        (
            "Creating",
            "create",
            &[
                ("100,000: JSON rows", "JSON rows"),
                ("100,000: JSON columns", "JSON columns"),
                ("100,000: CBOR lists", "CBOR lists"),
                ("100,000: CBOR typed arrays", "CBOR typed arrays"),
            ],
        ),
        ("A snapshot", "snapshot", &[("GET", "taken"), ("PUT", "restored")]),
    ];
    let of = |case: &str, figure: &str| wire.one(&[("case", case), ("figure", figure)]).number("measured");
    let all = groups.iter().flat_map(|(_, case, ways)| ways.iter().map(move |(way, _)| (*case, *way)));
    let most = all.map(|(case, way)| of(case, &format!("{way}, a particle"))).fold(0.0, f64::max);
    let mut y = picture.head() + 16.0;
    for (title, case, ways) in groups {
        picture.text((16.0, y), Anchor::Start, title);
        y += 12.0;
        for (way, name) in ways {
            let seconds = of(case, &format!("{way}, a particle"));
            let ratio = of(case, &format!("{way} / raw socket"));
            let length = 300.0 * seconds / most;
            picture.text((226.0, y + 20.0), Anchor::End, name);
            let colour = if name.starts_with("JSON") { Colour::Blue } else { Colour::Green };
            picture.bar((238.0, y), (length, 26.0), colour, 0.9);
            let ratio = if ratio < 9.95 { format!("{ratio:.1}") } else { format!("{ratio:.0}") };
            picture.text(
                (248.0 + length, y + 20.0),
                Anchor::Start,
                &format!("{}, {ratio} × socket", time(1e9 * seconds)),
            );
            y += 32.0;
        }
        y += 34.0;
    }
    picture.origin(y - 12.0, &wire.origin);
    picture.finish(y)
}

/// A tick of a game, in seconds.
const TICK: f64 = 1.0 / 60.0;
const LEFT: f64 = 310.0;
const RIGHT: f64 = 776.0;
const LEAST: f64 = 3e-5;
const MOST: f64 = 3e-2;

pub(crate) fn load(load: &Recorded) -> String {
    let mut picture = Picture::new(
        "Light worlds answer within a tick, whatever else goes on",
        "20 worlds at 60 Hz: how long half, 99 % and 99.9 % of the requests took at most.",
    );
    let place = |seconds: f64| LEFT + (seconds / LEAST).log10() / (MOST / LEAST).log10() * (RIGHT - LEFT);
    let shares = [("median", "half", Colour::Green), ("p99", "99 %", Colour::Blue), ("p99.9", "99.9 %", Colour::Pink)];
    let mut y = picture.head() + 44.0;
    let top = y - 20.0;
    let rows = [
        ("fairness", "alone"),
        ("fairness", "beside one long advance"),
        ("fairness", "beside four long advances"),
        ("slow", "while slow clients come"),
        ("slow", "beside slow clients"),
        ("malformed", "beside malformed requests"),
    ];
    for (i, (case, beside)) in rows.into_iter().enumerate() {
        picture.text((LEFT - 12.0, y + 7.0), Anchor::End, beside);
        let figure = |share: &str| {
            let figure = format!("light worlds {beside}, {share}");
            load.one(&[("case", case), ("figure", &figure)]).number("measured")
        };
        let [from, .., to] = shares.map(|(share, ..)| place(figure(share)));
        picture.path(&[(from, y), (to, y)], Colour::Ink, Stroke::Dotted);
        for (share, name, colour) in shares {
            let x = place(figure(share));
            assert!((LEFT..RIGHT).contains(&x), "{beside}, {share}: beyond the axis");
            picture.dot((x, y), 7.0, colour);
            if i == 0 {
                let at = if share == "median" { x - 20.0 } else { x - 14.0 };
                picture.label((at, y - 16.0), colour, name);
            }
        }
        y += 42.0;
    }
    y -= 18.0;
    for (seconds, label) in [(1e-4, "0.1 ms"), (1e-3, "1 ms"), (1e-2, "10 ms")] {
        picture.grid((place(seconds), top + 4.0), (place(seconds), y));
        picture.text((place(seconds), y + 26.0), Anchor::Middle, label);
    }
    picture.path(&[(place(TICK), top + 4.0), (place(TICK), y)], Colour::Ink, Stroke::Dashed);
    picture.text((RIGHT + 8.0, top - 4.0), Anchor::End, "a tick, 1/60 s");
    picture.text((f64::midpoint(LEFT, RIGHT), y + 58.0), Anchor::Middle, "time until the answer");
    picture.origin(y + 92.0, &load.origin);
    picture.finish(y + 104.0)
}
