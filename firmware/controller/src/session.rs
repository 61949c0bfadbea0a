//! Exactly-once commands over a link that loses, repeats and delays: sequence numbers and a short memory of replies.

use flankscope_protocol::{Header, Refusal, Reply};
use heapless::Deque;

/// Replies kept for hosts that ask again.
const REPLIES_KEPT: usize = 4;

/// What to do with a command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Judgement {
    /// New: carry it out, then [`Session::remember`] the reply.
    Execute,
    /// A repetition: send this reply again, do nothing.
    Repeat(Reply),
    /// Neither: say why.
    Refuse(Refusal),
}

/// The one link session that is open.
#[derive(Debug, Clone, Default)]
pub struct Session {
    open: Option<(u32, u16)>,
    replies: Deque<(u16, Reply), REPLIES_KEPT>,
}

impl Session {
    /// No session is open.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            open: None,
            replies: Deque::new(),
        }
    }

    /// The open session's number.
    pub fn id(&self) -> Option<u32> {
        self.open.map(|(id, _)| id)
    }

    /// Judges a command by its addressing alone.
    #[must_use]
    pub fn judge(&self, header: Header, hello: bool) -> Judgement {
        match self.open {
            Some((id, last)) if id == header.session => {
                // Serial number arithmetic (RFC 1982): up to 32767 ahead is new, the rest lies in the past.
                let ahead = header.sequence.wrapping_sub(last);
                if ahead != 0 && ahead < 0x8000 {
                    return Judgement::Execute;
                }
                match self
                    .replies
                    .iter()
                    .find(|(sequence, _)| *sequence == header.sequence)
                {
                    Some((_, reply)) => Judgement::Repeat(reply.clone()),
                    None => Judgement::Refuse(Refusal::StaleSequence {
                        got: header.sequence,
                        last,
                    }),
                }
            }
            _ if hello => Judgement::Execute,
            _ => Judgement::Refuse(Refusal::NoSession {
                got: header.session,
            }),
        }
    }

    /// Opens the session of an accepted hello; everything before is forgotten.
    pub fn open(&mut self, header: Header) {
        self.open = Some((header.session, header.sequence));
        self.replies.clear();
    }

    /// Keeps the reply to a command that was carried out.
    pub fn remember(&mut self, header: Header, reply: &Reply) {
        let Some((id, last)) = &mut self.open else {
            return;
        };
        if *id != header.session {
            return;
        }
        *last = header.sequence;
        if self.replies.is_full() {
            let _oldest = self.replies.pop_front();
        }
        let _fits = self.replies.push_back((header.sequence, reply.clone()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(session: u32, sequence: u16) -> Header {
        Header {
            session,
            sequence,
            ack: 0,
        }
    }

    #[test]
    fn nothing_but_a_hello_opens_a_session() {
        let mut session = Session::new();
        let refused = Judgement::Refuse(Refusal::NoSession { got: 5 });
        assert_eq!(session.judge(header(5, 1), false), refused);
        assert_eq!(session.judge(header(5, 1), true), Judgement::Execute);
        session.open(header(5, 1));
        assert_eq!(session.judge(header(5, 2), false), Judgement::Execute);
        assert_eq!(
            session.judge(header(6, 2), false),
            Judgement::Refuse(Refusal::NoSession { got: 6 })
        );
    }

    #[test]
    fn a_command_is_executed_once_however_often_it_arrives() {
        let mut session = Session::new();
        session.open(header(5, u16::MAX - 2));
        session.remember(header(5, u16::MAX - 2), &Reply::Accepted);
        // Ten commands across the wrap of the counter, each delivered three times.
        let mut executed = 0;
        for n in 0..10u16 {
            let header = header(5, (u16::MAX - 1).wrapping_add(n));
            for _ in 0..3 {
                match session.judge(header, false) {
                    Judgement::Execute => {
                        executed += 1;
                        session.remember(header, &Reply::Accepted);
                    }
                    other => assert_eq!(other, Judgement::Repeat(Reply::Accepted)),
                }
            }
        }
        assert_eq!(executed, 10);
    }

    #[test]
    fn a_late_command_is_refused_not_executed() {
        let mut session = Session::new();
        session.open(header(5, 100));
        session.remember(header(5, 110), &Reply::Accepted);
        let late = Refusal::StaleSequence {
            got: 105,
            last: 110,
        };
        assert_eq!(
            session.judge(header(5, 105), false),
            Judgement::Refuse(late)
        );
    }
}
