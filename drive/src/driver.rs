//! The page that drives: only its requests are obeyed.

use std::time::{Duration, Instant};

use crate::message::Message;
use crate::request::{PageId, Request};

/// Longest silence of the driving page before the robots stop.
pub const SILENCE: Duration = Duration::from_millis(350);

/// The driving page and when it was last heard.
pub struct Driver {
    /// Id of the driving page, if there is one.
    pub page: Option<PageId>,
    since: Instant,
    /// Number of requests that the driving pages sent.
    pub count: u64,
}

/// The meaning of a message to the thread that plays the robots.
#[derive(Debug)]
pub enum Heard {
    /// A request of the driving page.
    Request(Request),
    /// Another page drives from now on, or none: what the last one held ends.
    Released,
    /// Nothing, for example a request of a page that does not drive.
    Nothing,
    /// A message that is not of a page.
    Other(Message),
}

impl Default for Driver {
    fn default() -> Self {
        Driver { page: None, since: Instant::now(), count: 0 }
    }
}

impl Driver {
    /// Returns true if the driving page has been silent for too long.
    pub fn is_silent(&self) -> bool {
        self.since.elapsed() > SILENCE
    }

    /// Takes a message. The first page drives until it goes or another one asks for the controls.
    pub fn take(&mut self, message: Message) -> Heard {
        match message {
            Message::PageOpened(page) if self.page.is_none() => self.hand_over(Some(page)),
            Message::PageClosed(page) if self.page == Some(page) => self.hand_over(None),
            Message::Request(page, Request::Drive) if self.page != Some(page) => self.hand_over(Some(page)),
            Message::Request(page, request) if self.page == Some(page) => {
                (self.since, self.count) = (Instant::now(), self.count + 1);
                Heard::Request(request)
            }
            Message::PageOpened(_) | Message::PageClosed(_) | Message::Request(..) => Heard::Nothing,
            other => Heard::Other(other),
        }
    }

    fn hand_over(&mut self, page: Option<PageId>) -> Heard {
        (self.page, self.since) = (page, Instant::now());
        Heard::Released
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_page_drives_until_it_goes_or_another_asks() {
        let mut driver = Driver::default();
        let reset = |page| Message::Request(page, Request::Pause(true));
        assert!(matches!(driver.take(reset(1)), Heard::Nothing));
        assert!(matches!(driver.take(Message::PageOpened(1)), Heard::Released));
        assert!(matches!(driver.take(Message::PageOpened(2)), Heard::Nothing));
        assert!(matches!(driver.take(reset(1)), Heard::Request(Request::Pause(true))));
        assert!(matches!(driver.take(reset(2)), Heard::Nothing));
        assert!(matches!(driver.take(Message::Request(2, Request::Drive)), Heard::Released));
        assert!(matches!(driver.take(Message::PageClosed(1)), Heard::Nothing));
        assert_eq!((driver.page, driver.count), (Some(2), 1));
        assert!(matches!(driver.take(Message::PageClosed(2)), Heard::Released));
        assert_eq!(driver.page, None);
        assert!(matches!(driver.take(Message::Notice("full".to_owned())), Heard::Other(Message::Notice(_))));
    }
}
