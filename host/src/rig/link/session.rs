//! The host's side of a session, sans-IO: bytes in, bytes out, time as an argument.
//!
//! It greets, repeats a command until its reply comes, puts events back in order, acknowledges
//! them, and keeps the heartbeat. The rules are those of [`cannula_shared::frame`].

use super::error::LinkError;
use cannula_shared::frame::{self, Decoder, Header, Kind, MAX_WIRE};
use cannula_shared::hello::{Hello, PROTOCOL};
use cannula_shared::message::{Command, Event, Reply, SCHEMA, Telemetry};
use cannula_shared::units::Micros;
use std::collections::{BTreeMap, VecDeque};

/// An unanswered command or hello is repeated after this long.
const REPEAT: Micros = Micros(40_000);
/// Nothing sent for this long: say that we live.
const HEARTBEAT: Micros = Micros(40_000);
/// Events that came before their turn wait here; more than the board has under way at once.
const AHEAD: u32 = 64;

/// What happened on the link, for the tests and for the curious.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Frames sent.
    pub sent: u64,
    /// Of them, commands sent again.
    pub repeated: u64,
    /// Sound frames received.
    pub received: u64,
    /// Damaged frames.
    pub bad: u32,
    /// Events that came again after they had been taken.
    pub doubles: u64,
}

/// A session with one board.
#[derive(Debug)]
pub struct Session {
    number: u16,
    decoder: Decoder,
    output: Vec<u8>,
    hello: Option<Hello>,
    failure: Option<LinkError>,
    /// The command under way, encoded.
    pending: Option<Command>,
    sequence: u32,
    reply: Option<Reply>,
    /// Next event to be handed out in order.
    next_event: u32,
    ahead: BTreeMap<u32, Event>,
    events: VecDeque<Event>,
    acknowledged: u32,
    telemetry: Option<Telemetry>,
    last_sent: Option<Micros>,
    command_sent: Option<Micros>,
    last_heard: Option<Micros>,
    counts: Counts,
}

impl Session {
    /// A session of the given number (not 0; a fresh one each time, so that remains of an older
    /// session are recognised).
    pub fn new(number: u16) -> Self {
        Session {
            number: number.max(1),
            decoder: Decoder::new(),
            output: vec![0],
            hello: None,
            failure: None,
            pending: None,
            sequence: 0,
            reply: None,
            next_event: 0,
            ahead: BTreeMap::new(),
            events: VecDeque::new(),
            acknowledged: 0,
            telemetry: None,
            last_sent: None,
            command_sent: None,
            last_heard: None,
            counts: Counts::default(),
        }
    }

    /// The board's greeting, once it has come.
    pub fn hello(&self) -> Option<&Hello> {
        self.hello.as_ref()
    }

    /// Why the session is over, if it is. Handed out once; it stays over.
    pub fn take_failure(&mut self) -> Option<LinkError> {
        self.failure.take()
    }

    /// Frames counted.
    pub fn counts(&self) -> Counts {
        Counts {
            bad: self.decoder.bad_frames(),
            ..self.counts
        }
    }

    /// When the board was last heard.
    pub fn last_heard(&self) -> Option<Micros> {
        self.last_heard
    }

    /// Sends a command; one at a time.
    pub fn command(&mut self, now: Micros, command: Command) -> Result<(), LinkError> {
        if self.pending.is_some() {
            return Err(LinkError::Busy);
        }
        self.reply = None;
        self.sequence += 1;
        self.pending = Some(command);
        self.command_sent = None;
        self.poll(now);
        Ok(())
    }

    /// Gives up on the command under way. (The board may still carry it out.)
    pub fn give_up(&mut self) {
        self.pending = None;
    }

    /// The reply to the last command.
    pub fn take_reply(&mut self) -> Option<Reply> {
        self.reply.take()
    }

    /// The next event, in the board's order, each exactly once.
    pub fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// The last position reported, once.
    pub fn take_telemetry(&mut self) -> Option<Telemetry> {
        self.telemetry.take()
    }

    /// Bytes for the board.
    pub fn take_output(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.output)
    }

    /// Bytes from the board.
    pub fn receive(&mut self, now: Micros, bytes: &[u8]) {
        let mut rest = bytes;
        while !rest.is_empty() {
            let (used, found) = self.decoder.feed(rest);
            rest = rest.get(used..).unwrap_or(&[]);
            if let Some((header, length)) = found {
                let payload = self.decoder.payload(length).to_vec();
                self.frame(now, header, &payload);
            }
        }
        // Acknowledge at once what has come: the board keeps it until then.
        if self.hello.is_some() && self.acknowledged != self.next_event.wrapping_sub(1) {
            self.send_alive(now);
        }
    }

    fn frame(&mut self, now: Micros, header: Header, payload: &[u8]) {
        self.counts.received += 1;
        if header.kind == Kind::Hello {
            self.greeted(now, header.session, payload);
            return;
        }
        if header.session != self.number || self.hello.is_none() {
            return;
        }
        self.last_heard = Some(now);
        match header.kind {
            Kind::Reply if header.sequence == self.sequence && self.pending.is_some() => {
                match frame::decode_message(payload) {
                    Some(reply) => {
                        self.pending = None;
                        self.reply = Some(reply);
                    }
                    None => self.fail(LinkError::Unexpected("a reply that cannot be read".into())),
                }
            }
            Kind::Event => match frame::decode_message(payload) {
                Some(event) => self.event(header.sequence, event),
                None => self.fail(LinkError::Unexpected("an event that cannot be read".into())),
            },
            Kind::Telemetry => self.telemetry = frame::decode_message(payload).or(self.telemetry),
            _ => {}
        }
    }

    fn greeted(&mut self, now: Micros, session: u16, payload: &[u8]) {
        let Some(hello) = Hello::decode(payload) else {
            return;
        };
        if self.hello.is_some() {
            // Our own greeting answered twice is nothing new; one of another session is.
            if session == 0 {
                self.fail(LinkError::Restarted(hello.reset));
            } else if session != self.number {
                self.fail(LinkError::TakenOver);
            }
            return;
        }
        if session != self.number {
            return;
        }
        if hello.protocol != PROTOCOL {
            return self.fail(LinkError::Version {
                board: hello.protocol,
                host: PROTOCOL,
            });
        }
        if hello.schema != SCHEMA {
            return self.fail(LinkError::Schema {
                board: hello.schema,
                host: SCHEMA,
                firmware: hello.identity.firmware,
            });
        }
        self.next_event = hello.first_event;
        self.acknowledged = hello.first_event.wrapping_sub(1);
        self.last_heard = Some(now);
        self.hello = Some(hello);
    }

    fn event(&mut self, counter: u32, event: Event) {
        let distance = counter.wrapping_sub(self.next_event);
        if distance >= AHEAD {
            // Behind us: taken already, and its acknowledgement was lost. Say it again.
            if distance > u32::MAX / 2 {
                self.counts.doubles += 1;
                self.acknowledged = self.next_event.wrapping_sub(2);
            }
            return;
        }
        if self.ahead.insert(counter, event).is_some() {
            self.counts.doubles += 1;
        }
        while let Some(event) = self.ahead.remove(&self.next_event) {
            self.events.push_back(event);
            self.next_event = self.next_event.wrapping_add(1);
        }
    }

    fn fail(&mut self, error: LinkError) {
        self.pending = None;
        self.failure.get_or_insert(error);
    }

    /// Sends what is due: hello, command, heartbeat.
    pub fn poll(&mut self, now: Micros) {
        let due =
            |since: Option<Micros>, wait: Micros| since.is_none_or(|then| now.since(then) >= wait);
        if self.hello.is_none() {
            if due(self.last_sent, REPEAT) && self.failure.is_none() {
                self.send(now, Kind::Hello, 0, &[]);
            }
            return;
        }
        if let Some(command) = self.pending
            && due(self.command_sent, REPEAT)
        {
            if self.command_sent.is_some() {
                self.counts.repeated += 1;
            }
            self.command_sent = Some(now);
            let mut out = [0; MAX_WIRE];
            let header = self.header(Kind::Command, self.sequence);
            if let Some(length) = frame::encode_message(header, &command, &mut out) {
                self.put(now, &out[..length]);
            }
        }
        if due(self.last_sent, HEARTBEAT) {
            self.send_alive(now);
        }
    }

    fn send_alive(&mut self, now: Micros) {
        self.send(now, Kind::Alive, 0, &[]);
    }

    fn header(&self, kind: Kind, sequence: u32) -> Header {
        Header {
            kind,
            session: self.number,
            sequence,
            acknowledge: self.next_event.wrapping_sub(1),
        }
    }

    fn send(&mut self, now: Micros, kind: Kind, sequence: u32, payload: &[u8]) {
        let mut out = [0; MAX_WIRE];
        if let Some(length) = frame::encode(self.header(kind, sequence), payload, &mut out) {
            self.put(now, &out[..length]);
        }
    }

    fn put(&mut self, now: Micros, bytes: &[u8]) {
        self.output.extend_from_slice(bytes);
        self.last_sent = Some(now);
        self.acknowledged = self.next_event.wrapping_sub(1);
        self.counts.sent += 1;
    }
}
