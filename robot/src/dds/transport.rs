/*! RTPS over UDP on exactly one interface, with optional peers.

The transport that comes with dust_dds announces itself on every interface, whichever is chosen, takes ephemeral ports, and
finds others by multicast only. This one binds to the chosen address, takes the well-known ports, and can also announce itself to
peers one by one, as `lo` needs where it has no multicast.
*/

use std::io;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::sync::Mutex;

use dust_dds::std_runtime::executor::block_on;
use dust_dds::transport::interface::{
    RtpsTransportParticipant, TransportDataReceiver, TransportParticipantFactory, WriteMessage,
};
use dust_dds::transport::types::{LOCATOR_KIND_UDP_V4, Locator};
use socket2::{Domain, Protocol, Socket, Type};

use super::Place;

/// The multicast group of DDS discovery.
const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);

/// Participants tried on each peer; a host has few.
const PARTICIPANTS: u16 = 10;

/// Participants of a domain that one address has ports for.
const PLACES: u16 = 120;

/// Fragments are small enough for Ethernet.
const FRAGMENT_BYTES: usize = 1344;

/// The sockets of one participant, until dust_dds takes them.
pub struct Udp {
    address: Ipv4Addr,
    base: u16,
    peers: Vec<Ipv4Addr>,
    sockets: Mutex<Option<Sockets>>,
}

struct Sockets {
    meta: UdpSocket,
    user: UdpSocket,
    group: Option<UdpSocket>,
    out: UdpSocket,
}

impl Udp {
    pub fn open(place: &Place) -> io::Result<Self> {
        let base = 7400 + 250 * place.domain;
        let bind = |port| UdpSocket::bind(SocketAddrV4::new(place.address, port));
        let pair = |index: u16| {
            let port = base + 10 + 2 * index;
            Ok((bind(port)?, bind(port + 1)?))
        };
        let (meta, user) = (0..PLACES)
            .map(pair)
            .find(|pair: &io::Result<_>| !pair.as_ref().is_err_and(|error| error.kind() == io::ErrorKind::AddrInUse))
            .unwrap_or_else(|| Err(io::Error::new(io::ErrorKind::AddrInUse, "all 120 places are taken")))?;
        let out = Socket::from(user.try_clone()?);
        out.set_multicast_if_v4(&place.address)?;
        let sockets = Sockets { meta, user, group: group(place.address, base).ok(), out: out.into() };
        Ok(Udp { address: place.address, base, peers: place.peers.clone(), sockets: Mutex::new(Some(sockets)) })
    }
}

/// Joins the multicast group. Without multicast, only peers are reached.
fn group(address: Ipv4Addr, port: u16) -> io::Result<UdpSocket> {
    let group = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    group.set_reuse_address(true)?;
    group.set_reuse_port(true)?;
    group.bind(&SocketAddrV4::new(GROUP, port).into())?;
    group.join_multicast_v4(&GROUP, &address)?;
    Ok(group.into())
}

fn locator(address: Ipv4Addr, port: u16) -> Locator {
    let mut bytes = [0; 16];
    bytes[12..].copy_from_slice(&address.octets());
    Locator::new(LOCATOR_KIND_UDP_V4, port.into(), bytes)
}

fn listen(name: &str, socket: UdpSocket, receiver: TransportDataReceiver) {
    let run = move || {
        let mut buffer = vec![0; 65536];
        loop {
            if let Ok(length) = socket.recv(&mut buffer)
                && forget_types(&mut buffer[..length]).is_some()
            {
                block_on(receiver.receive_message(buffer[..length].to_vec()));
            }
        }
    };
    // Without a thread there is no memory either; the node then receives nothing, which its users detect.
    let _ = std::thread::Builder::new().name(name.into()).spawn(run);
}

impl TransportParticipantFactory for Udp {
    fn create_participant(&self, _: i32, receiver: TransportDataReceiver) -> RtpsTransportParticipant {
        let sockets = self.sockets.lock().ok().and_then(|mut sockets| sockets.take());
        let Some(Sockets { meta, user, group, out }) = sockets else {
            unreachable!("a node creates one participant from its sockets")
        };
        let port = |socket: &UdpSocket| socket.local_addr().map_or(0, |address| address.port());
        let (meta_port, user_port) = (port(&meta), port(&user));
        if let Some(group) = group {
            listen("dds multicast", group, receiver.clone());
        }
        listen("dds meta", meta, receiver.clone());
        listen("dds user", user, receiver);
        let own = SocketAddrV4::new(self.address, meta_port);
        let ports = (0..PARTICIPANTS).map(|index| self.base + 10 + 2 * index);
        let peers = self.peers.iter().flat_map(|peer| ports.clone().map(|port| SocketAddrV4::new(*peer, port)));
        let peers = peers.filter(|peer| *peer != own).collect();
        RtpsTransportParticipant {
            message_writer: Box::new(Writer { socket: out, peers, buffer: vec![0; 65507] }),
            default_unicast_locator_list: vec![locator(self.address, user_port)],
            metatraffic_unicast_locator_list: vec![locator(self.address, meta_port)],
            metatraffic_multicast_locator_list: vec![locator(GROUP, self.base)],
            default_multicast_locator_list: vec![],
            fragment_size: FRAGMENT_BYTES,
        }
    }
}

struct Writer {
    socket: UdpSocket,
    peers: Vec<SocketAddrV4>,
    buffer: Vec<u8>,
}

impl WriteMessage for Writer {
    fn write_buffer_mut(&mut self) -> &mut [u8] {
        &mut self.buffer
    }

    // UDP may lose a datagram anyway, so a failed send is a lost datagram.
    fn write_message(&mut self, length: usize, locators: &[Locator]) {
        let datagram = &self.buffer[..length];
        for to in locators {
            let [.., a, b, c, d] = to.address();
            let address = SocketAddrV4::new(Ipv4Addr::new(a, b, c, d), to.port() as u16);
            let peers = self.peers.iter().filter(|_| address.ip().is_multicast());
            for to in std::iter::once(&address).chain(peers) {
                let _ = self.socket.send_to(datagram, to);
            }
        }
    }
}

/// Kind of a submessage that carries data.
const DATA: u8 = 0x15;
/// Kinds of submessages that may be empty (PAD, INFO_TS); any other length 0 means "to the end".
const MAY_BE_EMPTY: [u8; 2] = [0x01, 0x09];
/// Kind of a submessage with the address for answers (INFO_REPLY), which no implementation that we know sends. dust_dds 0.16 has a `todo!`
/// there, whose panic would end DDS in this program.
const INFO_REPLY: u8 = 0x0F;
/// Parameter that carries the type information.
const TYPE_INFORMATION: u16 = 0x0075;
/// Parameter that ends a list.
const SENTINEL: u16 = 1;
/// The built-in writers that announce writers and readers.
const DISCOVERY_WRITERS: [[u8; 4]; 2] = [[0, 0, 3, 0xC2], [0, 0, 4, 0xC2]];

/// Blanks the type information that a peer announces with its readers and writers; `None` if the message is malformed, or has an
/// [`INFO_REPLY`], and must be dropped.
///
/// dust_dds 0.16 would ask such a peer for its types and match nothing until it answers, but Cyclone 0.10.2, the robot's, does not support
/// that request. Without the parameter both sides match by the type's name.
fn forget_types(message: &mut [u8]) -> Option<()> {
    let word = |message: &[u8], at: usize, little: bool| {
        let pair = [*message.get(at)?, *message.get(at + 1)?];
        Some(if little { u16::from_le_bytes(pair) } else { u16::from_be_bytes(pair) })
    };
    let mut at = 20;
    while at + 4 <= message.len() {
        let (kind, flags) = (message[at], message[at + 1]);
        if kind == INFO_REPLY {
            return None;
        }
        let little = flags & 1 == 1;
        let body = at + 4;
        let length = usize::from(word(message, at + 2, little)?);
        at = if length == 0 && !MAY_BE_EMPTY.contains(&kind) { message.len() } else { body + length };
        let is_discovery = DISCOVERY_WRITERS.iter().any(|writer| message.get(body + 8..body + 12) == Some(writer));
        if kind != DATA || flags & 4 == 0 || !is_discovery {
            continue;
        }
        let mut p = body + 4 + usize::from(word(message, body + 2, little)?);
        if flags & 2 != 0 {
            while word(message, p, little)? != SENTINEL {
                p += 4 + usize::from(word(message, p + 2, little)?);
            }
            p += 4;
        }
        let little = message.get(p + 1)? & 1 == 1;
        p += 4;
        while p + 4 <= at && word(message, p, little)? != SENTINEL {
            if word(message, p, little)? == TYPE_INFORMATION {
                message[p..p + 2].fill(0); // padding
            }
            p += 4 + usize::from(word(message, p + 2, little)?);
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A little-endian message that announces a writer: one parameter of each given kind, 4 bytes long, and the sentinel.
    fn announcement(parameters: &[u16]) -> Vec<u8> {
        // Extra flags, octets to inline QoS, reader, writer, sequence number; then the payload.
        let mut body = vec![0, 0, 16, 0, 0, 0, 3, 0xC7, 0, 0, 3, 0xC2, 0, 0, 0, 0, 1, 0, 0, 0];
        body.extend([0, 3, 0, 0]);
        for parameter in parameters {
            body.extend(parameter.to_le_bytes());
            body.extend([4, 0, 9, 9, 9, 9]);
        }
        body.extend([1, 0, 0, 0]);
        [&[0; 20][..], &[DATA, 0b101], &(body.len() as u16).to_le_bytes(), &body].concat()
    }

    #[test]
    fn type_information_becomes_padding() {
        let mut message = announcement(&[0x05, TYPE_INFORMATION, 0x07]);
        forget_types(&mut message).unwrap();
        assert_eq!(message, announcement(&[0x05, 0, 0x07]));
    }

    #[test]
    fn message_that_dust_dds_panics_on_is_not_heard() {
        let mut message = announcement(&[0x05]);
        message.extend([INFO_REPLY, 1, 4, 0, 0, 0, 0, 0]);
        assert_eq!(forget_types(&mut message), None);
    }

    #[test]
    fn no_message_makes_it_panic() {
        let whole = announcement(&[0x05, TYPE_INFORMATION, 0x07]);
        for length in 0..whole.len() {
            forget_types(&mut whole[..length].to_vec());
        }
        for place in 20..whole.len() {
            for value in [0, 1, 3, 0x7F, 0xFF] {
                let mut damaged = whole.clone();
                damaged[place] = value;
                forget_types(&mut damaged);
            }
        }
    }
}
