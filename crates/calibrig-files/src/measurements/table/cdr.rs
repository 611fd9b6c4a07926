//! Messages of ROS 2 as DDS writes them: CDR of OMG's DDS-XTypes 1.3, section 7.4, encoding version 1, in both orders of bytes.

use thiserror::Error;

/// Why bytes are not the expected message.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub(super) enum CdrError {
    /// Another encoding.
    #[error("its encoding is {0:#04x}, {name}; expected plain CDR (0x00 or 0x01)", name = encoding_name(*.0))]
    Encoding(u8),
    /// It is shorter than its content.
    #[error("it ends after {bytes} bytes, in {what}")]
    Short { what: &'static str, bytes: usize },
    /// Bytes that should be text but are not UTF-8.
    #[error("{what} is not text")]
    NoText { what: &'static str },
}

fn encoding_name(kind: u8) -> &'static str {
    match kind {
        2 | 3 => "a parameter list",
        6 | 7 => "CDR of version 2",
        8..=11 => "CDR of version 2 with lengths",
        _ => "unknown",
    }
}

/// Goes through a message. Places count from behind the four bytes that tell the encoding.
struct Cdr<'a> {
    bytes: &'a [u8],
    at: usize,
    little: bool,
}

impl<'a> Cdr<'a> {
    fn new(message: &'a [u8]) -> Result<Self, CdrError> {
        let short = CdrError::Short { what: "the encoding", bytes: message.len() };
        let (head, bytes) = message.split_at_checked(4).ok_or(short)?;
        match head {
            [0, kind @ (0 | 1), ..] => Ok(Self { bytes, at: 0, little: *kind == 1 }),
            [0, kind, ..] => Err(CdrError::Encoding(*kind)),
            _ => Err(CdrError::Encoding(0xff)),
        }
    }

    /// The next bytes of a number, which begins at a multiple of its size.
    fn number<const N: usize>(&mut self, what: &'static str) -> Result<[u8; N], CdrError> {
        let start = self.at.next_multiple_of(N);
        let short = CdrError::Short { what, bytes: self.bytes.len() + 4 };
        let end = start.checked_add(N).ok_or(short.clone())?;
        let bytes = self.bytes.get(start..end).and_then(|bytes| <[u8; N]>::try_from(bytes).ok());
        let mut bytes = bytes.ok_or(short)?;
        self.at = end;
        if !self.little {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn u32(&mut self, what: &'static str) -> Result<u32, CdrError> {
        Ok(u32::from_le_bytes(self.number(what)?))
    }

    fn f64(&mut self, what: &'static str) -> Result<f64, CdrError> {
        Ok(f64::from_le_bytes(self.number(what)?))
    }

    /// Length of a sequence whose elements take at least `least` bytes: at most what the message can hold.
    fn length(&mut self, what: &'static str, least: usize) -> Result<usize, CdrError> {
        let length = self.u32(what)? as usize;
        let room = (self.bytes.len() - self.at.min(self.bytes.len())) / least;
        if length > room {
            return Err(CdrError::Short { what, bytes: self.bytes.len() + 4 });
        }
        Ok(length)
    }

    /// A text, which ends with a zero byte; some writers leave that out of an empty one.
    fn text(&mut self, what: &'static str) -> Result<&'a str, CdrError> {
        let length = self.length(what, 1)?;
        let short = CdrError::Short { what, bytes: self.bytes.len() + 4 };
        let bytes = self.bytes.get(self.at..self.at + length).ok_or(short)?;
        self.at += length;
        let bytes = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        std::str::from_utf8(bytes).map_err(|_| CdrError::NoText { what })
    }

    fn numbers(&mut self, what: &'static str) -> Result<Vec<f64>, CdrError> {
        let length = self.length(what, 8)?;
        (0..length).map(|_| self.f64(what)).collect()
    }

    fn header(&mut self) -> Result<Header<'a>, CdrError> {
        let what = "its header";
        let seconds = i32::from_le_bytes(self.number(what)?);
        let nanoseconds = self.u32(what)?;
        let frame = self.text(what)?;
        Ok(Header { stamp_ns: i64::from(seconds) * 1_000_000_000 + i64::from(nanoseconds), frame })
    }
}

/// `std_msgs/Header`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Header<'a> {
    /// Since the epoch of its clock, ns.
    pub stamp_ns: i64,
    pub frame: &'a str,
}

/// `sensor_msgs/JointState`, without efforts.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct JointState<'a> {
    pub header: Header<'a>,
    pub names: Vec<&'a str>,
    /// rad or m
    pub positions: Vec<f64>,
    /// rad/s or m/s; may be empty.
    pub velocities: Vec<f64>,
}

/// Stamp of a message that begins with a header.
pub(super) fn stamp(message: &[u8]) -> Result<i64, CdrError> {
    Ok(Cdr::new(message)?.header()?.stamp_ns)
}

pub(super) fn joint_state(message: &[u8]) -> Result<JointState<'_>, CdrError> {
    let mut cdr = Cdr::new(message)?;
    let header = cdr.header()?;
    let count = cdr.length("the names of its joints", 4)?;
    let names = (0..count).map(|_| cdr.text("the names of its joints")).collect::<Result<_, _>>()?;
    let positions = cdr.numbers("the positions of its joints")?;
    let velocities = cdr.numbers("the velocities of its joints")?;
    Ok(JointState { header, names, positions, velocities })
}

/// A message with a place in it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Point<'a> {
    pub header: Header<'a>,
    /// `child_frame_id` of a transform.
    pub child: Option<&'a str>,
    /// m
    pub position: [f64; 3],
    /// Quaternion x, y, z, w of its orientation in the header's frame; `None` for a bare point.
    pub turn: Option<[f64; 4]>,
}

/// `geometry_msgs/PointStamped`.
pub(super) fn point(message: &[u8]) -> Result<Point<'_>, CdrError> {
    let mut cdr = Cdr::new(message)?;
    let header = cdr.header()?;
    Ok(Point { header, child: None, position: position(&mut cdr)?, turn: None })
}

/// `geometry_msgs/PoseStamped` and `PoseWithCovarianceStamped`, whose covariance stands behind the pose.
pub(super) fn pose(message: &[u8]) -> Result<Point<'_>, CdrError> {
    let mut cdr = Cdr::new(message)?;
    let header = cdr.header()?;
    Ok(Point { header, child: None, position: position(&mut cdr)?, turn: Some(turn(&mut cdr)?) })
}

/// `geometry_msgs/TransformStamped`; and `nav_msgs/Odometry`, whose pose stands behind its child frame as well.
pub(super) fn transform(message: &[u8]) -> Result<Point<'_>, CdrError> {
    let mut cdr = Cdr::new(message)?;
    let header = cdr.header()?;
    let child = Some(cdr.text("its child frame")?);
    Ok(Point { header, child, position: position(&mut cdr)?, turn: Some(turn(&mut cdr)?) })
}

fn position(cdr: &mut Cdr<'_>) -> Result<[f64; 3], CdrError> {
    let mut axis = || cdr.f64("its position");
    Ok([axis()?, axis()?, axis()?])
}

fn turn(cdr: &mut Cdr<'_>) -> Result<[f64; 4], CdrError> {
    let mut part = || cdr.f64("its orientation");
    Ok([part()?, part()?, part()?, part()?])
}
