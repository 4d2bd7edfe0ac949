/*! DDS on one network interface: a [`Node`] that publishes and listens.

The robot's own software (Cyclone DDS 0.10) needs more than dust_dds does by default: see `transport`, and the settings below. Messages at a
fixed rate are sent best-effort: a reliable writer blocks while a killed reader counts as alive, so one dead `ros2 topic echo` would stop
the robot.
*/

pub(crate) mod switcher;
mod transport;

use std::net::Ipv4Addr;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use anyhow::{Context, Result, anyhow, bail, ensure};
use dust_dds::dds_async::configuration::DustDdsConfigurationBuilder;
use dust_dds::dds_async::data_reader::DataReaderAsync;
use dust_dds::dds_async::domain_participant_factory::DomainParticipantFactoryAsync;
use dust_dds::domain::domain_participant::DomainParticipant;
use dust_dds::domain::domain_participant_factory::DomainParticipantFactory;
use dust_dds::infrastructure::error::{DdsError, DdsResult};
use dust_dds::infrastructure::listener::NO_LISTENER;
use dust_dds::infrastructure::qos::{DataReaderQos, DataWriterQos, QosKind};
use dust_dds::infrastructure::qos_policy::{HistoryQosPolicy, HistoryQosPolicyKind, ReliabilityQosPolicy};
use dust_dds::infrastructure::sample_info::{ANY_INSTANCE_STATE, ANY_SAMPLE_STATE, ANY_VIEW_STATE};
use dust_dds::infrastructure::status::{NO_STATUS, StatusKind};
use dust_dds::infrastructure::time::{Duration, DurationKind};
use dust_dds::publication::data_writer::DataWriter;
use dust_dds::std_runtime::StdRuntime;
use dust_dds::subscription::data_reader::DataReader;
use dust_dds::subscription::data_reader_listener::DataReaderListener;
use dust_dds::topic_definition::topic::Topic;
use dust_dds::xtypes::type_support::TypeSupport;
use network_interface::{Addr, NetworkInterface, NetworkInterfaceConfig};

/// The largest DDS domain: the ports of the next one would be beyond 65535.
const MAX_DOMAIN: u16 = 231;

fn dds(what: &'static str) -> impl Fn(DdsError) -> anyhow::Error {
    move |error| anyhow!("DDS, {what}: {error:?}")
}

/// The place in a network where a node listens and speaks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// DDS domain: 0 for a Go2, 1 by the custom of simulators.
    pub domain: u16,
    /// Address of the interface; nothing is sent on any other one.
    pub address: Ipv4Addr,
    /// Addresses of peers to announce to individually, for networks without multicast.
    pub peers: Vec<Ipv4Addr>,
}

impl Place {
    /// Returns the place on an interface, given by its name or by its address. A loopback interface announces to itself,
    /// since it often has no multicast.
    ///
    /// # Errors
    /// There is no such interface, or the domain is too large.
    pub fn new(interface: &str, domain: u16, peers: Vec<Ipv4Addr>) -> Result<Self> {
        ensure!(domain <= MAX_DOMAIN, "DDS domain {domain}: expected 0 to {MAX_DOMAIN}; a Go2 is in domain 0");
        let interfaces = NetworkInterface::show().unwrap_or_default();
        let ipv4 = |interface: &NetworkInterface| {
            interface.addr.iter().find_map(|addr| if let Addr::V4(addr) = addr { Some(addr.ip) } else { None })
        };
        let named: Vec<(&str, Ipv4Addr)> =
            interfaces.iter().filter_map(|interface| Some((interface.name.as_str(), ipv4(interface)?))).collect();
        let of_name = || named.iter().find(|(name, _)| *name == interface).map(|(_, address)| *address);
        let Some(address) = interface.parse().ok().or_else(of_name) else {
            let known: Vec<String> = named.iter().map(|(name, address)| format!("{name} ({address})")).collect();
            bail!("there is no network interface '{interface}' with an IPv4 address; there are: {}", known.join(", "));
        };
        let peers = if peers.is_empty() && address.is_loopback() { vec![address] } else { peers };
        Ok(Place { domain, address, peers })
    }
}

/// The command line of a place in a network.
#[derive(clap::Args, Debug)]
#[command(next_help_heading = "Network")]
pub struct Network {
    /// Network interface, by name or address; nothing is sent on any other
    #[arg(long, value_name = "NAME|ADDRESS", default_value = "lo")]
    pub interface: String,
    /// DDS domain: 0 for a Go2; simulators use 1
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub domain: u16,
    /// Address to announce to, for networks without multicast; may be repeated [default: itself, on a loopback interface]
    #[arg(long, value_name = "ADDRESS")]
    pub peer: Vec<Ipv4Addr>,
}

impl Network {
    pub(crate) fn place(&self) -> Result<Place> {
        Place::new(&self.interface, self.domain, self.peer.clone())
    }
}

/// A message that arrived, with its time and its writer.
pub(crate) struct Arrival<T> {
    pub message: T,
    pub at: Instant,
    pub writer: WriterId,
}

/// Identity of a writer.
pub type WriterId = [u8; 16];

/// The delivery of messages: best effort for what is sent at a fixed rate, where a lost message is lost; reliable for requests and
/// responses, which are repeated.
pub use dust_dds::infrastructure::qos_policy::ReliabilityQosPolicyKind as Delivery;

fn reliability(kind: Delivery) -> ReliabilityQosPolicy {
    ReliabilityQosPolicy { kind, max_blocking_time: DurationKind::Finite(Duration::new(0, 100_000_000)) }
}

/// Messages kept by a reader until they are taken.
const DEPTH: u32 = 16;

/// A participant of a DDS domain on one interface.
pub struct Node {
    participant: DomainParticipant,
    /// The topics by name: DDS creates each of them once.
    topics: Mutex<Vec<(String, Topic)>>,
}

/// Publishes messages on a topic.
pub struct Publisher<T> {
    writer: DataWriter<T>,
}

/// A subscription, which lasts until it is dropped.
pub(crate) type Subscription<T> = DataReader<T>;

impl<T: TypeSupport> Publisher<T> {
    /// Sends a message.
    ///
    /// # Errors
    /// A reliable reader does not answer, or the participant is gone.
    pub fn send(&self, message: T) -> Result<()> {
        self.writer.write(message, None).map_err(dds("sending"))
    }

    /// Returns the identity that arrivals of its messages carry.
    pub fn id(&self) -> WriterId {
        self.writer.get_instance_handle().into()
    }
}

impl Node {
    /// Joins a domain.
    ///
    /// # Errors
    /// The ports are in use, or the address is not one of this machine.
    pub fn open(place: &Place) -> Result<Self> {
        let Place { domain, address, .. } = *place;
        let udp = transport::Udp::open(place)
            .with_context(|| format!("cannot open the ports of DDS domain {domain} on {address}"))?;
        let configuration = DustDdsConfigurationBuilder::new()
            .participant_announcement_interval(std::time::Duration::from_secs(1))
            // With type information, neither Cyclone 0.10 nor 11 match.
            .enable_type_information(false)
            .build()
            .map_err(dds("configuration"))?;
        let id = std::process::id().to_be_bytes();
        let factory = DomainParticipantFactoryAsync::new(StdRuntime::new(), id, address.octets(), udp, configuration);
        // dust_dds needs a static factory; as a program opens only one node, it may be leaked.
        let participant = DomainParticipantFactory::new(Box::leak(Box::new(factory)))
            .create_participant(domain.into(), QosKind::Default, NO_LISTENER, NO_STATUS)
            .map_err(dds("joining"))?;
        Ok(Node { participant, topics: Mutex::default() })
    }

    fn topic<T: TypeSupport + 'static>(&self, name: &str, type_name: &str) -> DdsResult<Topic> {
        let mut topics = self.topics.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, topic)) = topics.iter().find(|(known, _)| known == name) {
            return Ok(topic.clone());
        }
        let topic = self.participant.create_topic::<T>(name, type_name, QosKind::Default, NO_LISTENER, NO_STATUS)?;
        topics.push((name.to_owned(), topic.clone()));
        Ok(topic)
    }

    /// Publishes on a topic.
    ///
    /// # Errors
    /// The topic exists with another type.
    pub fn publish<T: TypeSupport + 'static>(
        &self,
        topic: &str,
        type_name: &str,
        delivery: Delivery,
    ) -> Result<Publisher<T>> {
        let qos = DataWriterQos { reliability: reliability(delivery), ..Default::default() };
        let publish = || {
            let topic = self.topic::<T>(topic, type_name)?;
            let publisher = self.participant.create_publisher(QosKind::Default, NO_LISTENER, NO_STATUS)?;
            publisher.create_datawriter(&topic, QosKind::Specific(qos), NO_LISTENER, NO_STATUS)
        };
        Ok(Publisher { writer: publish().map_err(dds("publishing"))? })
    }

    /// Calls `take` with every message of a topic, in a thread of DDS, until the subscription is dropped.
    pub(crate) fn listen<T: TypeSupport + Send + Sync + 'static>(
        &self,
        topic: &str,
        type_name: &str,
        delivery: Delivery,
        take: impl FnMut(Arrival<T>) + Send + 'static,
    ) -> Result<Subscription<T>> {
        let qos = DataReaderQos {
            history: HistoryQosPolicy { kind: HistoryQosPolicyKind::KeepLast(DEPTH) },
            reliability: reliability(delivery),
            ..Default::default()
        };
        let listen = || {
            let topic = self.topic::<T>(topic, type_name)?;
            let subscriber = self.participant.create_subscriber(QosKind::Default, NO_LISTENER, NO_STATUS)?;
            let listener = Listener(take);
            subscriber.create_datareader(&topic, QosKind::Specific(qos), Some(listener), &[StatusKind::DataAvailable])
        };
        listen().map_err(dds("listening"))
    }
}

struct Listener<F>(F);

impl<T: TypeSupport + Send + Sync + 'static, F: FnMut(Arrival<T>) + Send + 'static> DataReaderListener<T>
    for Listener<F>
{
    async fn on_data_available(&mut self, reader: DataReaderAsync<T>) {
        let at = Instant::now();
        let samples = reader.take(DEPTH as i32, ANY_SAMPLE_STATE, ANY_VIEW_STATE, ANY_INSTANCE_STATE).await;
        for sample in samples.into_iter().flatten() {
            let writer = sample.sample_info.publication_handle.into();
            sample.data.into_iter().for_each(|message| self.0(Arrival { message, at, writer }));
        }
    }
}
