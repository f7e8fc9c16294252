//! One published state of a running simulation.
//!
//! | offset | bytes | member |
//! |---|---|---|
//! | 0 | 8 | `sequence`, u64 |
//! | 8 | 8 | `time_s`, f64 |
//! | 16 | 8 | `generation`, u64 |
//! | 24 | 56 | `rigid`, 7 × f64: position x y z in m, quaternion x y z w |
//! | 80 | 4 | `n`, u32 |
//! | 84 | 4 n | `q`, n × f32 |
//!
//! Little-endian, nothing between or after. (The bincode 2 fixed-width form of the members, but for
//! `n`, which bincode would make a u64.)

use crate::session::MAX_BASIS_SIZE;

/// Bytes before `q`.
pub const HEADER_BYTES: usize = 84;

/// `rigid` of a body that is held in place.
pub const RIGID_IDENTITY: [f64; 7] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];

/// One published state.
#[derive(Clone, Debug, PartialEq)]
pub struct StateFrame {
    /// Counts published states from 1; gaps are states that were dropped on the way.
    pub sequence: u64,
    /// Simulated time in s.
    pub time_s: f64,
    /// The generation whose basis `q` refers to.
    pub generation: u64,
    /// Rigid motion: position in m, then a unit quaternion x y z w.
    pub rigid: [f64; 7],
    /// Reduced coordinates.
    pub q: Vec<f32>,
}

/// Bytes that are not a state frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StateFrameError {
    /// Fewer bytes than the fixed part.
    #[error("a state frame has at least {HEADER_BYTES} bytes, not {0}")]
    TooShort(usize),
    /// `n` and the number of bytes disagree.
    #[error("a state frame of {n} coordinates has {expected} bytes, not {actual}")]
    Length {
        /// Coordinates announced.
        n: u32,
        /// Bytes they need.
        expected: u64,
        /// Bytes there are.
        actual: usize,
    },
    /// More coordinates than any basis has columns.
    #[error("a state frame has at most {MAX_BASIS_SIZE} coordinates, not {0}")]
    TooLong(usize),
    /// A number is NaN or infinite.
    #[error("a state frame holds a number that is not finite")]
    NonFinite,
}

impl StateFrame {
    /// The frame as bytes. Refuses what [`StateFrame::decode`] would refuse.
    pub fn encode(&self) -> Result<Vec<u8>, StateFrameError> {
        self.check()?;
        let mut bytes = Vec::with_capacity(HEADER_BYTES + 4 * self.q.len());
        bytes.extend_from_slice(&self.sequence.to_le_bytes());
        bytes.extend_from_slice(&self.time_s.to_le_bytes());
        bytes.extend_from_slice(&self.generation.to_le_bytes());
        bytes.extend_from_slice(bytemuck::cast_slice(&self.rigid));
        bytes.extend_from_slice(&(self.q.len() as u32).to_le_bytes());
        bytes.extend_from_slice(bytemuck::cast_slice(&self.q));
        Ok(bytes)
    }

    /// The frame that `bytes` holds, all of them.
    pub fn decode(bytes: &[u8]) -> Result<StateFrame, StateFrameError> {
        let too_short = StateFrameError::TooShort(bytes.len());
        let (head, tail) = bytes.split_first_chunk::<HEADER_BYTES>().ok_or(too_short)?;
        let eight = |at: usize| -> [u8; 8] { std::array::from_fn(|i| head[at + i]) };
        let n = u32::from_le_bytes(std::array::from_fn(|i| head[80 + i]));
        let expected = HEADER_BYTES as u64 + 4 * u64::from(n);
        if bytes.len() as u64 != expected {
            return Err(StateFrameError::Length { n, expected, actual: bytes.len() });
        }
        let frame = StateFrame {
            sequence: u64::from_le_bytes(eight(0)),
            time_s: f64::from_le_bytes(eight(8)),
            generation: u64::from_le_bytes(eight(16)),
            rigid: std::array::from_fn(|i| f64::from_le_bytes(eight(24 + 8 * i))),
            q: bytemuck::pod_collect_to_vec(tail),
        };
        frame.check()?;
        Ok(frame)
    }

    fn check(&self) -> Result<(), StateFrameError> {
        if self.q.len() > MAX_BASIS_SIZE {
            return Err(StateFrameError::TooLong(self.q.len()));
        }
        let finite = self.time_s.is_finite()
            && self.rigid.iter().all(|x| x.is_finite())
            && self.q.iter().all(|x| x.is_finite());
        if finite { Ok(()) } else { Err(StateFrameError::NonFinite) }
    }
}
