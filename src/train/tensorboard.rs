/*! TensorBoard event files, written record by record.

An event file is a sequence of TFRecords, each a protobuf `Event` between two masked CRC-32C sums (tensorflow's
`record_writer.cc`, `event.proto`, `summary.proto`). The few fields that scalars need are declared here by hand, so that
the build needs no protoc. The first event names the format's version; the second marks the start of a session at a
step, which makes TensorBoard drop whatever an earlier, interrupted session wrote from that step on.
*/

use std::fs::File;
use std::io::{self, Write as _};
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use prost::Message;

/// A writer of scalars to one new event file.
#[derive(Debug)]
pub struct EventWriter {
    file: File,
    session_started: bool,
}

impl EventWriter {
    /// Starts a new file `events.out.tfevents.<unix seconds>.<process id>.supple` in a directory, which is created if
    /// it is missing.
    ///
    /// # Errors
    /// The directory or the file cannot be created or written.
    pub fn create(dir: &Path) -> io::Result<Self> {
        std::fs::create_dir_all(dir)?;
        let wall_time_s = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
        let path = dir.join(format!("events.out.tfevents.{wall_time_s:010.0}.{}.supple", std::process::id()));
        // Appending: a second writer in the same second of the same process must not cut the first one's file.
        let file = File::options().create(true).append(true).open(path)?;
        let mut writer = EventWriter { file, session_started: false };
        writer.write(0, wall_time_s, event::What::FileVersion("brain.Event:2".into()))?;
        Ok(writer)
    }

    /// Writes the values of a step, each a (tag, value) pair; they are in the file when this returns. The first call also marks its step as
    /// the session's start: TensorBoard drops what earlier files of the directory hold for this step and later ones.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn scalars(&mut self, step: u64, wall_time_s: f64, values: &[(&str, f64)]) -> io::Result<()> {
        let step = i64::try_from(step).unwrap_or(i64::MAX);
        if !self.session_started {
            let status = SessionStatus::Start.into();
            self.write(step, wall_time_s, event::What::SessionLog(SessionLog { status }))?;
            self.session_started = true;
        }
        let value = |&(tag, value): &(&str, f64)| Value { tag: tag.to_owned(), simple_value: Some(value as f32) };
        let value = values.iter().map(value).collect();
        self.write(step, wall_time_s, event::What::Summary(Summary { value }))
    }

    /// Writes one record without buffering: a reader never sees half a record for long, and nothing is left to flush.
    fn write(&mut self, step: i64, wall_time: f64, what: event::What) -> io::Result<()> {
        let what = Some(what);
        self.file.write_all(&record(&TensorboardEvent { wall_time, step, what }.encode_to_vec()))
    }
}

/// Encodes a TFRecord: length, masked sum of the length, data, masked sum of the data; numbers little-endian.
fn record(data: &[u8]) -> Vec<u8> {
    let length = (data.len() as u64).to_le_bytes();
    [&length[..], &masked_crc(&length).to_le_bytes(), data, &masked_crc(data).to_le_bytes()].concat()
}

/// Computes the CRC-32C rotated right by 15 bits plus a constant, which protects data that contain sums themselves.
fn masked_crc(data: &[u8]) -> u32 {
    crc32c::crc32c(data).rotate_right(15).wrapping_add(0xa282_ead8)
}

/// The message `tensorflow.Event`.
#[derive(Clone, PartialEq, Message)]
struct TensorboardEvent {
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(oneof = "event::What", tags = "3, 5, 7")]
    what: Option<event::What>,
}

mod event {
    /// The oneof `tensorflow.Event.what`, with the kinds that are written here.
    #[derive(Clone, PartialEq, prost::Oneof)]
    pub(super) enum What {
        #[prost(string, tag = "3")]
        FileVersion(String),
        #[prost(message, tag = "5")]
        Summary(super::Summary),
        #[prost(message, tag = "7")]
        SessionLog(super::SessionLog),
    }
}

/// The message `tensorflow.Summary`.
#[derive(Clone, PartialEq, Message)]
struct Summary {
    #[prost(message, repeated, tag = "1")]
    value: Vec<Value>,
}

/// The message `tensorflow.Summary.Value`; the number is optional because a zero is written, too.
#[derive(Clone, PartialEq, Message)]
struct Value {
    #[prost(string, tag = "1")]
    tag: String,
    #[prost(float, optional, tag = "2")]
    simple_value: Option<f32>,
}

/// The message `tensorflow.SessionLog`.
#[derive(Clone, PartialEq, Message)]
struct SessionLog {
    #[prost(enumeration = "SessionStatus", tag = "1")]
    status: i32,
}

/// The enumeration `tensorflow.SessionLog.SessionStatus`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, prost::Enumeration)]
#[repr(i32)]
enum SessionStatus {
    Unspecified = 0,
    Start = 1,
}

#[cfg(test)]
mod tests {
    use super::*;

    /* The goldens come from the real thing (tensorboard 2.21.0):

        from tensorboard.compat.proto.event_pb2 import Event, SessionLog
        from tensorboard.compat.proto.summary_pb2 import Summary
        from tensorboard.compat.tensorflow_stub.pywrap_tensorflow import masked_crc32c
        import struct
        print(hex(masked_crc32c(b"123456789")), hex(masked_crc32c(b"")))
        values = [Summary.Value(tag="reward/mean", simple_value=0.25)]
        e = Event(wall_time=1.5, step=7, summary=Summary(value=values)).SerializeToString()
        h = struct.pack("<Q", len(e))
        print((h + struct.pack("<I", masked_crc32c(h)) + e + struct.pack("<I", masked_crc32c(e))).hex(" "))
        print(Event(wall_time=1.5, step=7, session_log=SessionLog(status=SessionLog.START)).SerializeToString().hex(" "))
    */
    const SCALAR_RECORD: &str = "21 00 00 00 00 00 00 00 01 7b ec f6 09 00 00 00 00 00 00 f8 3f 10 07 2a 14 0a 12 0a 0b 72 \
                                 65 77 61 72 64 2f 6d 65 61 6e 15 00 00 80 3e 25 50 37 ee";
    const SESSION_START: &str = "09 00 00 00 00 00 00 f8 3f 10 07 3a 02 08 01";

    fn bytes(hex: &str) -> Vec<u8> {
        hex.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
    }

    #[test]
    fn masked_crc_is_that_of_tensorflow() {
        assert_eq!(masked_crc(b"123456789"), 0xc78a_b0e5);
        assert_eq!(masked_crc(b""), 0xa282_ead8);
    }

    #[test]
    fn file_is_version_then_session_start_then_scalars_on_disk_at_once() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = EventWriter::create(&dir.path().join("run")).unwrap();
        writer.scalars(7, 1.5, &[("reward/mean", 0.25)]).unwrap();
        writer.scalars(7, 1.5, &[("reward/mean", 0.25)]).unwrap();
        let path = std::fs::read_dir(dir.path().join("run")).unwrap().next().unwrap().unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        assert!(name.starts_with("events.out.tfevents.") && name.ends_with(".supple"), "{name}");

        let content = std::fs::read(path).unwrap();
        let length = u64::from_le_bytes(content[..8].try_into().unwrap()) as usize;
        let (first, rest) = content.split_at(length + 16);
        let version = TensorboardEvent::decode(&first[12..12 + length]).unwrap();
        assert_eq!(version.what, Some(event::What::FileVersion("brain.Event:2".into())));
        let scalar = bytes(SCALAR_RECORD);
        assert_eq!(rest, [record(&bytes(SESSION_START)), scalar.clone(), scalar].concat());
    }

    #[test]
    fn a_value_of_zero_is_written_and_not_left_out() {
        let value = Value { tag: "a".into(), simple_value: Some(0.0) };
        assert_eq!(value.encode_to_vec(), bytes("0a 01 61 15 00 00 00 00"));
    }
}
