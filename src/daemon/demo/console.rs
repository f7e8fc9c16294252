//! Where the story goes: standard output, or standard error where standard output is for JSON.

/// Prints lines for people.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Console {
    pub(crate) json: bool,
}

impl Console {
    pub(crate) fn line(&self, line: &str) {
        if self.json { eprintln!("{line}") } else { println!("{line}") }
    }

    /// A line that opens a part of the story.
    pub(crate) fn heading(&self, heading: &str) {
        self.line("");
        self.line(heading);
    }
}
