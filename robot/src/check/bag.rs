//! Logs as MCAP: what `ros2 bag record -s mcap /lowstate /lowcmd` writes, or another program that keeps the robot's messages.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use anyhow::anyhow;
use mcap::read::LinearReader;
use mcap::records::Record;
use supple::util::files::{FileError, read_bounded};

use super::Columns;
use crate::bridge::log::{COMPLIANCE, Row};
use crate::message::{Cdr, Field, LowCmd, LowState};

/// Most bytes of a file.
const MOST_BYTES: u64 = 1 << 30;

/// Reads each command with the state before it. A bag has no command of the policy, so `constants` gives it.
pub(super) fn read(path: &Path, columns: &Columns) -> anyhow::Result<Vec<Row>> {
    let fail = FileError::of("cannot read the log", path);
    let bytes = read_bounded(path, MOST_BYTES).map_err(|error| fail(error.to_string()))?;
    let constant = |name| {
        let words = "a bag has no command of the policy: give";
        let of_constants = columns.constants.get(name).copied();
        of_constants.ok_or_else(|| anyhow!("{words} {name} in a YAML file (--columns), under `constants`"))
    };
    let command = [constant("command_forward")?, constant("command_left")?, constant("command_yaw")?];
    let compliance = columns.constants.get(COMPLIANCE).copied().unwrap_or(0.0);
    let (mut state, mut start_ns, mut rows) = (None, None, Vec::new());
    let topics = for_each_message(&bytes, |topic, time_ns, data| {
        let no_message = |what: &str| format!("a message of the topic {topic} is not the Go2's {what} in CDR");
        match topic.rsplit('/').next() {
            Some("lowstate") => state = Some(decoded::<LowState>(data).ok_or_else(|| no_message("LowState"))?),
            Some("lowcmd") => {
                let sent: LowCmd = decoded(data).ok_or_else(|| no_message("LowCmd"))?;
                let time_s = 1e-9 * time_ns.saturating_sub(*start_ns.get_or_insert(time_ns)) as f64;
                rows.extend(state.as_ref().map(|state| Row { compliance, ..row(time_s, state, &sent, command) }));
            }
            _ => {}
        }
        Ok(())
    })
    .map_err(fail)?;
    if rows.is_empty() {
        let topics = topics.into_values().collect::<Vec<_>>().join(", ");
        let problem = "it has no command after a state, on topics that end in lowcmd and lowstate";
        return Err(fail(format!("{problem}; its topics: {topics}")).into());
    }
    Ok(rows)
}

/// Calls `f` with topic, time \[ns\] and data of each message; returns the topics. Chunks are decompressed here: the mcap crate (0.25)
/// loops for ever on a truncated chunk.
fn for_each_message(
    bytes: &[u8],
    mut f: impl FnMut(&str, u64, &[u8]) -> Result<(), String>,
) -> Result<BTreeMap<u16, String>, String> {
    let mut topics = BTreeMap::new();
    let mut take = |record: Record| match record {
        Record::Channel(channel) => {
            topics.insert(channel.id, channel.topic);
            Ok(())
        }
        Record::Message { header, data } => {
            let topic = topics.get(&header.channel_id);
            f(topic.ok_or("a message is of no channel")?, header.log_time, &data)
        }
        _ => Ok(()),
    };
    let words = |error: mcap::McapError| error.to_string();
    for record in LinearReader::new(bytes).map_err(words)? {
        let (header, data) = match record.map_err(words)? {
            Record::Chunk { header, data } => (header, data),
            other => {
                take(other)?;
                continue;
            }
        };
        let mut chunk = Vec::new();
        let plain: &[u8] = match header.compression.as_str() {
            "" => &data,
            "zstd" => {
                let decoder = zstd::Decoder::new(&*data).map_err(|error| error.to_string())?;
                decoder.take(MOST_BYTES).read_to_end(&mut chunk).map_err(|error| error.to_string())?;
                &chunk
            }
            other => return Err(format!("it is compressed with {other}; none and zstd are read")),
        };
        for record in LinearReader::sans_magic(plain) {
            take(record.map_err(words)?)?;
        }
    }
    Ok(topics)
}

fn decoded<T: Field>(message: &[u8]) -> Option<T> {
    T::read(&mut Cdr::new(message)?)
}

fn row(time_s: f64, state: &LowState, sent: &LowCmd, command: [f64; 3]) -> Row {
    let (tick_s, q) = (1e-3 * f64::from(state.tick), state.of_motors(|motor| motor.q));
    let (dq, tau) = (state.of_motors(|motor| motor.dq), state.of_motors(|motor| motor.tau_est));
    let (quaternion, gyro) = (state.imu_state.quaternion.map(f64::from), state.imu_state.gyroscope.map(f64::from));
    let accelerometer = state.imu_state.accelerometer.map(f64::from);
    let target = std::array::from_fn(|joint| f64::from(sent.motor_cmd[joint].q));
    let gains = [sent.motor_cmd[0].kp, sent.motor_cmd[0].kd].map(f64::from);
    Row { time_s, tick_s, q, dq, tau, quaternion, gyro, accelerometer, command, compliance: 0.0, target, gains }
}

#[cfg(test)]
pub(super) mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::check::LogRows;
    use crate::message::tests::cdr;
    use crate::message::{MotorCmd, SERVO, filled};

    /// A bag of these rows, as a recorder of ROS 2 writes it.
    fn bag(rows: &[Row]) -> Vec<u8> {
        let mut writer = mcap::Writer::new(Cursor::new(Vec::new())).unwrap();
        let states = writer.add_channel(0, "/lowstate", "cdr", &BTreeMap::new()).unwrap();
        let commands = writer.add_channel(0, "/lowcmd", "cdr", &BTreeMap::new()).unwrap();
        for (index, row) in rows.iter().enumerate() {
            let mut state = LowState { tick: (1e3 * row.tick_s).round() as u32, ..LowState::zero() };
            state.imu_state.quaternion = row.quaternion.map(|value| value as f32);
            state.imu_state.gyroscope = row.gyro.map(|value| value as f32);
            state.imu_state.accelerometer = row.accelerometer.map(|value| value as f32);
            let motors = std::array::from_fn(|joint| {
                let motor = &mut state.motor_state[joint];
                (motor.q, motor.dq, motor.tau_est) = (row.q[joint] as f32, row.dq[joint] as f32, row.tau[joint] as f32);
                let [kp, kd] = row.gains.map(|gain| gain as f32);
                MotorCmd { mode: SERVO, q: row.target[joint] as f32, kp, kd, ..MotorCmd::zero() }
            });
            for (channel_id, data) in [(states, cdr(&state)), (commands, cdr(&LowCmd::of_motors(&motors)))] {
                let time = 2_000_000 * index as u64;
                let header =
                    mcap::records::MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
                writer.write_to_known_channel(&header, &data).unwrap();
            }
        }
        writer.finish().unwrap();
        writer.into_inner().into_inner()
    }

    fn columns() -> Columns {
        let constants = [("command_forward", 0.4), ("command_left", 0.2), ("command_yaw", 0.3), (COMPLIANCE, 0.02)];
        let constants = constants.map(|(name, value)| (name.to_owned(), value)).into();
        Columns { constants, from_s: 0.01, ..Columns::default() }
    }

    fn read_bytes(bytes: &[u8], columns: &Columns) -> Result<LogRows, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.mcap");
        std::fs::write(&path, bytes).unwrap();
        LogRows::read(&path, columns).map_err(|error| error.to_string())
    }

    #[test]
    fn bag_has_the_rows_that_were_recorded() {
        let rows: Vec<Row> = (0..20)
            .map(|index| Row {
                time_s: 0.002 * f64::from(index),
                tick_s: 0.002 * f64::from(index),
                command: [0.4, 0.2, 0.3],
                compliance: 0.02,
                ..crate::bridge::log::tests::row(f64::from(index))
            })
            .collect();
        let read = read_bytes(&bag(&rows), &columns()).unwrap();
        assert_eq!(read.0.len(), rows.len());
        for (index, ((phase, read), row)) in read.0.iter().zip(&rows).enumerate() {
            assert_eq!(phase, if index < 5 { "hold" } else { "policy" });
            for (read, row) in read.numbers().iter().zip(row.numbers()) {
                assert!((read - row).abs() < 1e-9, "row {index}: {read} and {row}");
            }
        }
    }

    #[test]
    fn broken_bag_is_refused_in_words() {
        let bytes = bag(&[crate::bridge::log::tests::row(1.0)]);
        for length in (0..bytes.len()).step_by(7) {
            read_bytes(&bytes[..length], &columns()).unwrap_err();
        }
        for at in (0..bytes.len()).step_by(11) {
            let mut bytes = bytes.clone();
            bytes[at] ^= 0x80;
            let _ = read_bytes(&bytes, &columns());
        }
        let mut writer = mcap::Writer::new(Cursor::new(Vec::new())).unwrap();
        let channel_id = writer.add_channel(0, "rt/lowstate", "cdr", &BTreeMap::new()).unwrap();
        let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
        writer.write_to_known_channel(&header, &cdr(&filled::<LowState>(2))[..500]).unwrap();
        writer.finish().unwrap();
        let error = read_bytes(&writer.into_inner().into_inner(), &columns()).unwrap_err();
        assert!(error.contains("rt/lowstate") && error.contains("LowState"), "{error}");
        let error = read_bytes(&bytes, &Columns::default()).unwrap_err();
        assert!(error.contains("command_forward") && error.contains("constants"), "{error}");
    }
}
