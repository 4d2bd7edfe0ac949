//! Encoders of videos: MP4 with H.264 and WebP, in memory.

use std::num::NonZeroU32;
use std::path::Path;

use openh264::OpenH264API;
use openh264::encoder::{EncoderConfig, FrameRate, FrameType, IntraFramePeriod, Profile, RateControlMode, VuiConfig};
use openh264::formats::{RgbSliceU8, YUVBuffer};
use shiguredo_mp4::TrackKind;
use shiguredo_mp4::bitstream::h264::{
    H264NalUnitType as Unit, H264SampleEntryConfig, LengthSize, build_avc1_box_from_annexb, parse_annexb_nal_units,
};
use shiguredo_mp4::boxes::SampleEntry;
use shiguredo_mp4::mux::{Mp4FileMuxer, Sample};
use webp_animation::{EncoderOptions, EncodingConfig};

use super::{FRAME_RATE, Result, VideoError};

/// Quality of WebP, 0 to 100.
const WEBP_QUALITY: f32 = 55.0;

/// Format of a video.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    Mp4,
    WebP,
}

impl Format {
    /// Returns the format that the ending of a file's name stands for.
    pub(super) fn of(path: &Path) -> Option<Self> {
        let endings = [("mp4", Format::Mp4), ("webp", Format::WebP)];
        let found = path.extension()?;
        endings.into_iter().find(|(ending, _)| found.eq_ignore_ascii_case(ending)).map(|(_, format)| format)
    }
}

/// An encoder of pictures of one size.
pub(super) struct Encoder {
    kind: Kind,
    size: [usize; 2],
    frames: u32,
}

enum Kind {
    Mp4(Box<Mp4>),
    WebP(Box<webp_animation::Encoder>),
}

fn failed(error: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> VideoError {
    VideoError::Encode(error.into())
}

/// Returns the time of a frame \[ms\].
fn time_of(frame: u32) -> i32 {
    (u64::from(frame) * 1000 / u64::from(FRAME_RATE)) as i32
}

impl Encoder {
    pub(super) fn new(format: Format, size: [usize; 2]) -> Result<Self> {
        let [width, height] = size;
        let kind = match format {
            Format::Mp4 => Kind::Mp4(Box::new(Mp4::new()?)),
            Format::WebP => {
                let encoding_config = Some(EncodingConfig::new_lossy(WEBP_QUALITY));
                let options = EncoderOptions { encoding_config, ..EncoderOptions::default() };
                let webp = webp_animation::Encoder::new_with_options((width as u32, height as u32), options);
                Kind::WebP(Box::new(webp.map_err(failed)?))
            }
        };
        Ok(Encoder { kind, size, frames: 0 })
    }

    /// Adds a picture, shape (height, width, 3).
    pub(super) fn frame(&mut self, rgb: &[u8]) -> Result<()> {
        match &mut self.kind {
            Kind::Mp4(mp4) => mp4.frame(rgb, self.size)?,
            Kind::WebP(webp) => {
                let rgba: Vec<u8> = rgb.chunks(3).flat_map(|pixel| [pixel[0], pixel[1], pixel[2], 255]).collect();
                webp.add_frame(&rgba, time_of(self.frames)).map_err(failed)?;
            }
        }
        self.frames += 1;
        Ok(())
    }

    pub(super) fn finish(self) -> Result<Vec<u8>> {
        match self.kind {
            Kind::Mp4(mp4) => mp4.finish(),
            Kind::WebP(webp) => Ok(webp.finalize(time_of(self.frames)).map_err(failed)?.to_vec()),
        }
    }
}

/// An MP4 file with one track of H.264.
struct Mp4 {
    encoder: openh264::encoder::Encoder,
    muxer: Mp4FileMuxer,
    file: Vec<u8>,
    is_empty: bool,
}

impl Mp4 {
    fn new() -> Result<Self> {
        // The same quantisation for every picture: with a bit rate, OpenH264 prints a warning unless it may leave pictures out.
        let config = EncoderConfig::new()
            .rate_control_mode(RateControlMode::Off)
            .max_frame_rate(FrameRate::from_hz(FRAME_RATE as f32))
            .intra_frame_period(IntraFramePeriod::from_num_frames(4 * FRAME_RATE))
            .skip_frames(false)
            .profile(Profile::Main)
            .vui(VuiConfig::bt601())
            // More would cut frames into as many slices: the file would depend on the machine.
            .num_threads(1);
        let encoder =
            openh264::encoder::Encoder::with_api_config(OpenH264API::from_source(), config).map_err(failed)?;
        let muxer = Mp4FileMuxer::new().map_err(failed)?;
        let file = muxer.initial_boxes_bytes().to_vec();
        Ok(Mp4 { encoder, muxer, file, is_empty: true })
    }

    fn frame(&mut self, rgb: &[u8], [width, height]: [usize; 2]) -> Result<()> {
        let yuv = YUVBuffer::from_rgb8_source(RgbSliceU8::new(rgb, (width, height)));
        let coded = self.encoder.encode(&yuv).map_err(failed)?;
        let (keyframe, stream) = (matches!(coded.frame_type(), FrameType::IDR | FrameType::I), coded.to_vec());
        // The parameters of the stream are in the file's header alone.
        let config = H264SampleEntryConfig { length_size: LengthSize::FourBytes };
        let entry = || build_avc1_box_from_annexb(&stream, &config).map(SampleEntry::Avc1).map_err(failed);
        let sample_entry = self.is_empty.then(entry).transpose()?;
        let data_offset = self.file.len() as u64;
        let units = parse_annexb_nal_units(&stream).map_err(failed)?;
        for unit in units.iter().filter(|unit| !matches!(unit.nal_unit_type, Unit::Sps | Unit::Pps)) {
            self.file.extend((unit.data.len() as u32).to_be_bytes());
            self.file.extend(unit.data);
        }
        self.is_empty = false;
        let sample = Sample {
            track_kind: TrackKind::Video,
            sample_entry,
            keyframe,
            timescale: const { NonZeroU32::new(FRAME_RATE).unwrap() },
            duration: 1,
            composition_time_offset: None,
            data_offset,
            data_size: self.file.len() - data_offset as usize,
        };
        self.muxer.append_sample(&sample).map_err(failed)
    }

    fn finish(mut self) -> Result<Vec<u8>> {
        let ends = self.muxer.finalize().map_err(failed)?;
        for (offset, bytes) in ends.offset_and_bytes_pairs() {
            let (start, end) = (offset as usize, offset as usize + bytes.len());
            self.file.resize(self.file.len().max(end), 0);
            self.file[start..end].copy_from_slice(bytes);
        }
        Ok(self.file)
    }
}
