//! Lines, boxes and words as SVG.

use std::fmt::Write;

/// Where a text is from its point.
#[derive(Clone, Copy)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// A picture that grows.
pub(super) struct Svg {
    width: i32,
    height: i32,
    title: &'static str,
    body: String,
}

impl Svg {
    /// An empty picture; the title is what a screen reader says.
    pub(super) const fn new(width: i32, height: i32, title: &'static str) -> Self {
        Self { width, height, title, body: String::new() }
    }

    pub(super) fn text(&mut self, (x, y): (i32, i32), anchor: Anchor, style: &str, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let text = text.replace('&', "&amp;").replace('<', "&lt;");
        self.push(&format!("<text x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\" {style}>{text}</text>"));
    }

    pub(super) fn rect(&mut self, (x, y): (i32, i32), (width, height): (i32, i32), style: &str) {
        self.push(&format!(
            "<rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" rx=\"5\" {style}/>"
        ));
    }

    /// A line in the form of SVG's path data.
    pub(super) fn path(&mut self, data: &str, style: &str) {
        self.push(&format!("<path d=\"{data}\" {style}/>"));
    }

    /// The file.
    pub(super) fn finish(self) -> String {
        let Self { width, height, title, body } = self;
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"13\">\n  \
             <title>{title}</title>\n  \
             <defs>\n    \
             <marker id=\"arrow\" viewBox=\"0 0 10 10\" refX=\"9\" refY=\"5\" markerWidth=\"8\" markerHeight=\"8\" orient=\"auto-start-reverse\">\n      \
             <path d=\"M0 0 10 5 0 10z\" fill=\"#444\"/>\n    \
             </marker>\n  \
             </defs>\n  \
             <rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n{body}</svg>\n"
        )
    }

    fn push(&mut self, element: &str) {
        let _ = writeln!(self.body, "  {element}");
    }
}
