//! The board's end of the link, sans-IO: executes each command once, answers a repeated one from
//! memory, repeats events until they are acknowledged. The rules are those of
//! [`cannula_shared::frame`].

use crate::ledger::Ledger;
use cannula_shared::error::Refusal;
use cannula_shared::frame::{self, Decoder, Header, Kind, MAX_WIRE};
use cannula_shared::hello::{Hello, Identity, ResetReason};
use cannula_shared::message::{Command, Event, Reply, Telemetry};
use cannula_shared::units::Micros;

/// Events under way at once.
const WINDOW: usize = 8;
/// Unacknowledged events are sent again after this long.
const REPEAT: Micros = Micros(40_000);
/// A host of another session is told about it no more often than this.
const REMIND: Micros = Micros(100_000);

/// The link's state.
#[derive(Debug)]
pub struct Link {
    decoder: Decoder,
    identity: Identity,
    reset: ResetReason,
    session: u16,
    new_session: bool,
    /// Number of the last command taken.
    sequence: u32,
    inbox: Option<Command>,
    reply: Option<Reply>,
    send_reply: bool,
    send_hello: Option<u16>,
    reminded: Option<Micros>,
    /// Events.
    pub ledger: Ledger,
    under_way: usize,
    events_sent: Micros,
    telemetry: Option<Telemetry>,
    heard: Option<Micros>,
    out: [u8; MAX_WIRE],
    out_used: usize,
    out_at: usize,
}

impl Link {
    /// A link that will say hello unasked.
    pub const fn new(identity: Identity, reset: ResetReason) -> Self {
        Link {
            decoder: Decoder::new(),
            identity,
            reset,
            session: 0,
            new_session: false,
            sequence: 0,
            inbox: None,
            reply: None,
            send_reply: false,
            send_hello: Some(0),
            reminded: None,
            ledger: Ledger::new(),
            under_way: 0,
            events_sent: Micros(0),
            telemetry: None,
            heard: None,
            out: [0; MAX_WIRE],
            out_used: 0,
            out_at: 0,
        }
    }

    /// How long the host has been silent; for ever, if there is none.
    pub fn silence(&self, now: Micros) -> Micros {
        self.heard
            .map_or(Micros(u64::MAX), |heard| now.since(heard))
    }

    /// Damaged frames so far.
    pub const fn bad_frames(&self) -> u32 {
        self.decoder.bad_frames()
    }

    /// Whether a new host has come since the last call.
    pub fn take_new_session(&mut self) -> bool {
        core::mem::take(&mut self.new_session)
    }

    /// The next command; it must be answered by [`Self::answer`].
    pub fn take_command(&mut self) -> Option<Command> {
        self.inbox.take()
    }

    /// Answers the last command.
    pub fn answer(&mut self, reply: Reply) {
        self.reply = Some(reply);
        self.send_reply = true;
    }

    /// Whether the answer to the last command has left.
    pub const fn answered(&self) -> bool {
        !self.send_reply && self.out_at >= self.out_used
    }

    /// A position for the host; replaces one that has not left yet.
    pub fn report(&mut self, telemetry: Telemetry) {
        self.telemetry = Some(telemetry);
    }

    /// Adds an event to the ledger.
    pub fn event(&mut self, event: Event) -> bool {
        self.ledger.push(event)
    }

    /// The connection was cut: half frames are worthless.
    pub fn disconnected(&mut self) {
        self.decoder.reset();
        self.out_used = 0;
        self.out_at = 0;
        self.telemetry = None;
        self.under_way = 0;
    }

    /// Takes bytes from the host.
    pub fn receive(&mut self, now: Micros, bytes: &[u8]) {
        let mut rest = bytes;
        while !rest.is_empty() {
            let (used, found) = self.decoder.feed(rest);
            rest = rest.get(used..).unwrap_or(&[]);
            if let Some((header, length)) = found {
                self.frame(now, header, length);
            }
        }
    }

    fn frame(&mut self, now: Micros, header: Header, length: usize) {
        if header.kind == Kind::Hello {
            if header.session != 0 {
                self.greet(now, header.session);
            }
            return;
        }
        if !matches!(header.kind, Kind::Command | Kind::Alive) {
            return;
        }
        if header.session != self.session || self.session == 0 {
            // A host that has not noticed that we started anew, or that another took over.
            if self.reminded.is_none_or(|then| now.since(then) >= REMIND) {
                self.reminded = Some(now);
                self.send_hello = Some(self.session);
            }
            return;
        }
        self.heard = Some(now);
        let gone = self.ledger.acknowledge(header.acknowledge);
        self.under_way = self.under_way.saturating_sub(gone);
        if gone > 0 {
            self.events_sent = now;
        }
        if header.kind == Kind::Command {
            if header.sequence == self.sequence.wrapping_add(1) && self.inbox.is_none() {
                self.sequence = header.sequence;
                self.reply = None;
                match frame::decode_message::<Command>(self.decoder.payload(length)) {
                    Some(command) => self.inbox = Some(command),
                    None => self.answer(Reply::Refused(Refusal::Malformed)),
                }
            } else if header.sequence == self.sequence && self.reply.is_some() {
                self.send_reply = true;
            }
        }
    }

    fn greet(&mut self, now: Micros, session: u16) {
        self.send_hello = Some(session);
        self.heard = Some(now);
        if session != self.session {
            self.session = session;
            self.new_session = true;
            self.sequence = 0;
            self.inbox = None;
            self.reply = None;
            self.send_reply = false;
            self.telemetry = None;
            self.under_way = 0;
        }
    }

    /// Puts bytes for the host into `out`; how many.
    pub fn transmit(&mut self, now: Micros, out: &mut [u8]) -> usize {
        let mut count = 0;
        while count < out.len() {
            if self.out_at >= self.out_used && !self.compose(now) {
                break;
            }
            let left = self.out.get(self.out_at..self.out_used).unwrap_or(&[]);
            let room = out.get_mut(count..).unwrap_or(&mut []);
            let moved = left.len().min(room.len());
            for (to, from) in room.iter_mut().zip(left) {
                *to = *from;
            }
            self.out_at += moved;
            count += moved;
        }
        count
    }

    /// Whether there is something to say at `now`.
    pub fn has_output(&self, now: Micros) -> bool {
        self.out_at < self.out_used
            || self.send_hello.is_some()
            || (self.session != 0
                && (self.send_reply
                    || self.telemetry.is_some()
                    || self.under_way < self.ledger.pending().min(WINDOW)
                    || self.resend_due(now)))
    }

    fn resend_due(&self, now: Micros) -> bool {
        self.under_way > 0 && now.since(self.events_sent) >= REPEAT
    }

    /// Makes the next frame, if there is one: greetings and replies first.
    fn compose(&mut self, now: Micros) -> bool {
        self.out_at = 0;
        self.out_used = 0;
        let header = |kind, session, sequence| Header {
            kind,
            session,
            sequence,
            acknowledge: 0,
        };
        let length = if let Some(session) = self.send_hello.take() {
            let hello = Hello::of(self.identity, self.reset, now, self.ledger.first());
            frame::encode(
                header(Kind::Hello, session, 0),
                &hello.encode(),
                &mut self.out,
            )
        } else if self.session == 0 {
            None
        } else if let (true, Some(reply)) = (self.send_reply, &self.reply) {
            self.send_reply = false;
            frame::encode_message(
                header(Kind::Reply, self.session, self.sequence),
                reply,
                &mut self.out,
            )
        } else {
            if self.resend_due(now) {
                self.under_way = 0;
            }
            let next = if self.under_way < WINDOW {
                self.ledger.get(self.under_way)
            } else {
                None
            };
            if let Some((counter, event)) = next {
                if self.under_way == 0 {
                    self.events_sent = now;
                }
                self.under_way += 1;
                frame::encode_message(
                    header(Kind::Event, self.session, counter),
                    event,
                    &mut self.out,
                )
            } else if let Some(telemetry) = self.telemetry.take() {
                frame::encode_message(
                    header(Kind::Telemetry, self.session, 0),
                    &telemetry,
                    &mut self.out,
                )
            } else {
                None
            }
        };
        self.out_used = length.unwrap_or(0);
        length.is_some()
    }
}
