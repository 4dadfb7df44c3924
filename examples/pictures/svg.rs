//! A picture: shapes and words, 800 wide, without a ground of its own, in colours that are read on white and on dark pages.

use std::fmt::{Display, Write};

pub(crate) const WIDTH: f64 = 800.0;

/// What a reader tells things apart by: each is read on white and on black.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Colour {
    Ink,
    Blue,
    Orange,
    Green,
    Purple,
    Pink,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stroke {
    Full,
    Dashed,
    /// From a curve to its name, or between dots.
    Dotted,
    /// One of some, and one of many.
    Medium,
    Thin,
}

impl Colour {
    const fn class(self) -> &'static str {
        match self {
            Self::Ink => "ink",
            Self::Blue => "blue",
            Self::Orange => "orange",
            Self::Green => "green",
            Self::Purple => "purple",
            Self::Pink => "pink",
        }
    }
}

/// Grey ink of medium lightness is read on both; a page that says it is dark gets lighter ink.
const STYLE: &str = "text{font:20px system-ui,-apple-system,'Segoe UI','Liberation Sans',Arial,sans-serif;fill:#6e7781}\
.title{font-size:22px;font-weight:600}.note{font-size:17px}.origin{font-size:14px}.bar{fill:#fff}\
.grid{stroke:#848d97;stroke-opacity:.28}\
.ink{fill:#7b848e;stroke:#7b848e}.blue{fill:#2f7ed8;stroke:#2f7ed8}.orange{fill:#d9730d;stroke:#d9730d}\
.green{fill:#1a9850;stroke:#1a9850}.purple{fill:#9a60d0;stroke:#9a60d0}.pink{fill:#d6456b;stroke:#d6456b}\
path{fill:none!important;stroke-linejoin:round}text,rect{stroke:none!important}\
@media(prefers-color-scheme:dark){text,text.ink{fill:#d1d7e0}path.ink,circle.ink,rect.ink{fill:#a5aeb8;stroke:#a5aeb8}\
text.bar{fill:#fff}}";

#[derive(Debug)]
pub(crate) struct Picture {
    title: String,
    body: String,
    /// Where the next line of the head stands.
    head: f64,
}

impl Picture {
    /// With what there is to see above it, and below that what is shown.
    pub(crate) fn new(title: &str, note: &str) -> Self {
        let mut picture = Self { title: title.to_owned(), body: String::new(), head: 30.0 };
        for line in lines(title, 58) {
            picture.words((16.0, picture.head), "title", Anchor::Start, &line);
            picture.head += 28.0;
        }
        for line in lines(note, 86) {
            picture.words((16.0, picture.head), "note", Anchor::Start, &line);
            picture.head += 23.0;
        }
        picture
    }

    /// Below what is written at the top.
    pub(crate) fn head(&self) -> f64 {
        self.head
    }

    pub(crate) fn text(&mut self, at: (f64, f64), anchor: Anchor, text: &str) {
        self.words(at, "", anchor, text);
    }

    pub(crate) fn label(&mut self, at: (f64, f64), colour: Colour, text: &str) {
        self.words(at, colour.class(), Anchor::Start, text);
    }

    /// On a bar.
    pub(crate) fn on_bar(&mut self, at: (f64, f64), text: &str) {
        self.words(at, "bar", Anchor::Start, text);
    }

    /// Where the numbers come from.
    pub(crate) fn origin(&mut self, y: f64, text: &str) {
        self.words((16.0, y), "origin", Anchor::Start, text);
    }

    fn words(&mut self, (x, y): (f64, f64), class: &str, anchor: Anchor, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "",
            Anchor::Middle => " text-anchor=\"middle\"",
            Anchor::End => " text-anchor=\"end\"",
        };
        let class = if class.is_empty() { String::new() } else { format!(" class=\"{class}\"") };
        self.push(format_args!("<text x=\"{x:.1}\" y=\"{y:.1}\"{class}{anchor}>{}</text>", escaped(text)));
    }

    pub(crate) fn grid(&mut self, (x1, y1): (f64, f64), (x2, y2): (f64, f64)) {
        self.push(format_args!("<path class=\"grid\" d=\"M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}\"/>"));
    }

    pub(crate) fn path(&mut self, points: &[(f64, f64)], colour: Colour, stroke: Stroke) {
        let mut places = String::new();
        for (i, (x, y)) in points.iter().enumerate() {
            let verb = if i == 0 { 'M' } else { 'L' };
            write!(places, "{verb}{x:.1} {y:.1}").expect("a string takes it");
        }
        let look = match stroke {
            Stroke::Full => "stroke-width=\"3\"",
            Stroke::Dashed => "stroke-width=\"2.5\" stroke-dasharray=\"7 6\"",
            Stroke::Dotted => "stroke-opacity=\".55\" stroke-dasharray=\"1.5 3.5\"",
            Stroke::Medium => "stroke-width=\"1.6\"",
            Stroke::Thin => "stroke-opacity=\".4\"",
        };
        self.push(format_args!("<path class=\"{}\" {look} d=\"{places}\"/>", colour.class()));
    }

    pub(crate) fn dot(&mut self, (x, y): (f64, f64), radius: f64, colour: Colour) {
        let class = colour.class();
        self.push(format_args!("<circle class=\"{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\"/>"));
    }

    /// A bar from its upper left corner on.
    pub(crate) fn bar(&mut self, (x, y): (f64, f64), (width, height): (f64, f64), colour: Colour, opacity: f64) {
        self.push(format_args!(
            "<rect class=\"{}\" x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" \
             opacity=\"{opacity}\"/>",
            colour.class()
        ));
    }

    pub(crate) fn finish(self, height: f64) -> String {
        let title = escaped(&self.title);
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{height:.0}\" \
             viewBox=\"0 0 {WIDTH} {height:.0}\" role=\"img\" aria-label=\"{title}\">\n<style>{STYLE}</style>\n{}</svg>\n",
            self.body
        )
    }

    fn push(&mut self, element: impl Display) {
        writeln!(self.body, "{element}").expect("a string takes it");
    }
}

/// As many words in a line as fit into so many letters. Fonts differ; the widest common one sets how many these are.
fn lines(text: &str, letters: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let last = lines.last_mut().expect("there is one");
        if last.is_empty() {
            last.push_str(word);
        } else if last.chars().count() + 1 + word.chars().count() <= letters {
            last.push(' ');
            last.push_str(word);
        } else {
            lines.push(word.to_owned());
        }
    }
    lines
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}
