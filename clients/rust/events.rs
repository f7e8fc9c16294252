//! Server-sent events (the WHATWG's `text/event-stream`).

use crate::error::{Error, Result};
use reqwest::Response;
use sutura_proto::event::Event;

/// Longest event accepted.
const MAX_EVENT_BYTES: usize = 1 << 20;

/// What happens to a session, as it happens.
#[derive(Debug)]
pub struct EventStream {
    response: Response,
    lines: Lines,
}

impl EventStream {
    pub(crate) fn new(response: Response) -> EventStream {
        EventStream { response, lines: Lines::default() }
    }

    /// The next event; `None` once the daemon has closed the stream.
    pub async fn next(&mut self) -> Result<Option<Event>> {
        loop {
            if let Some(event) = self.lines.event()? {
                return Ok(Some(event));
            }
            match self.response.chunk().await? {
                Some(chunk) => self.lines.push(&chunk)?,
                None => return Ok(None),
            }
        }
    }
}

/// Bytes on their way to becoming events.
#[derive(Debug, Default)]
struct Lines {
    /// Bytes behind the last whole line.
    rest: Vec<u8>,
    /// The lines of `data:` of the event that is arriving, joined.
    data: String,
    /// Events that have arrived whole, the first one last.
    events: Vec<String>,
}

impl Lines {
    fn push(&mut self, chunk: &[u8]) -> Result<()> {
        let mut arrived = Vec::new();
        for byte in chunk {
            if *byte != b'\n' {
                self.rest.push(*byte);
            } else {
                let line = std::mem::take(&mut self.rest);
                arrived.extend(self.line(line.strip_suffix(b"\r").unwrap_or(&line)));
            }
            if self.rest.len() + self.data.len() > MAX_EVENT_BYTES {
                return Err(Error::TooLarge { limit: MAX_EVENT_BYTES });
            }
        }
        arrived.reverse();
        arrived.append(&mut self.events);
        self.events = arrived;
        Ok(())
    }

    /// Takes one line; returns the event that it ends.
    fn line(&mut self, line: &[u8]) -> Option<String> {
        if line.is_empty() {
            return (!self.data.is_empty()).then(|| std::mem::take(&mut self.data));
        }
        // Only `data` matters: the document repeats the event's name. Comments keep the line alive.
        if let Some(value) = line.strip_prefix(b"data:") {
            if !self.data.is_empty() {
                self.data.push('\n');
            }
            let value = value.strip_prefix(b" ").unwrap_or(value);
            self.data.push_str(&String::from_utf8_lossy(value));
        }
        None
    }

    fn event(&mut self) -> Result<Option<Event>> {
        self.events.pop().map(|data| Ok(serde_json::from_str(&data)?)).transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_arrive_whole_however_they_are_cut() {
        let bytes = b": hello\n\nevent: stage\ndata: {\"event\":\"stage\",\r\n\
            data:\"stage\":\"modes\",\"progress\":0.5}\r\n\r\nevent: deleted\n\
            data: {\"event\":\"deleted\"}\n\n";
        for size in 1..bytes.len() {
            let mut lines = Lines::default();
            let mut events = Vec::new();
            for chunk in bytes.chunks(size) {
                lines.push(chunk).unwrap();
                while let Some(event) = lines.event().unwrap() {
                    events.push(event);
                }
            }
            let stage = Event::Stage { stage: "modes".to_owned(), progress: 0.5 };
            assert_eq!(events, [stage, Event::Deleted], "chunks of {size}");
        }
    }

    #[test]
    fn endless_lines_and_wrong_documents_are_refused() {
        let mut lines = Lines::default();
        let error = lines.push(&vec![b'x'; MAX_EVENT_BYTES + 1]).unwrap_err();
        assert!(matches!(error, Error::TooLarge { .. }));
        let mut lines = Lines::default();
        lines.push(b"data: {\"event\":\"nonsense\"}\n\n").unwrap();
        assert!(matches!(lines.event(), Err(Error::Decode(_))));
    }
}
