//! The byte formats: round trips, golden bytes, hostile lengths; and the keys.

use proptest::prelude::*;
use sutura_proto::array::{Array, DType, Data};
use sutura_proto::frame::{self, Frame, FrameError};
use sutura_proto::keys::{self, Resource};
use sutura_proto::npy::{self, NpyError};
use sutura_proto::session::MAX_BASIS_SIZE;
use sutura_proto::state::{HEADER_BYTES, RIGID_IDENTITY, StateFrame, StateFrameError};

fn small_frame() -> Frame<'static> {
    let w = Array::f64("w", [1], vec![1.0]);
    Frame { generation: 2, arrays: vec![Array::f32("a", [1, 3], vec![1.0f32, 2.0, 0.5]), w] }
}

const SMALL_FRAME: [u8; 120] = *b"SUTURA\x01\0\
    \x02\0\0\0\0\0\0\0\
    \x02\0\0\0\0\0\0\0\
    \x01\0\0\0\0\0\0\0a\
    \0\0\0\0\
    \x02\0\0\0\0\0\0\0\x01\0\0\0\0\0\0\0\x03\0\0\0\0\0\0\0\
    \x01\0\0\0\0\0\0\0w\
    \x01\0\0\0\
    \x01\0\0\0\0\0\0\0\x01\0\0\0\0\0\0\0\
    \0\0\0\0\0\0\
    \0\0\x80\x3f\0\0\0\x40\0\0\0\x3f\
    \0\0\0\0\
    \0\0\0\0\0\0\xf0\x3f";

#[test]
fn a_small_frame_has_these_bytes() {
    assert_eq!(small_frame().encode().unwrap(), SMALL_FRAME);
    assert_eq!(Frame::decode(&SMALL_FRAME).unwrap(), small_frame());
}

#[test]
fn frames_are_views_where_the_bytes_are_aligned_and_copies_where_not() {
    let mut shifted = vec![0u8; SMALL_FRAME.len() + 8];
    let aligned = shifted.as_ptr().align_offset(8);
    for (offset, borrowed) in [(aligned, true), ((aligned + 1) % 8, false)] {
        shifted[offset..offset + SMALL_FRAME.len()].copy_from_slice(&SMALL_FRAME);
        let frame = Frame::decode(&shifted[offset..offset + SMALL_FRAME.len()]).unwrap();
        assert_eq!(frame, small_frame());
        let Data::F64(w) = &frame.arrays[1].data else { panic!("w is {:?}", frame.arrays[1]) };
        assert_eq!(matches!(w, std::borrow::Cow::Borrowed(_)), borrowed);
    }
}

#[test]
fn no_damaged_frame_is_accepted_and_none_panics() {
    for length in 0..SMALL_FRAME.len() {
        assert!(Frame::decode(&SMALL_FRAME[..length]).is_err(), "{length} bytes");
    }
    let mut longer = SMALL_FRAME.to_vec();
    longer.push(0);
    let length = FrameError::Length { expected: 120, actual: 121 };
    assert_eq!(Frame::decode(&longer).unwrap_err(), length);
    let with_u64 = |at: usize, value: u64| {
        let mut bytes = SMALL_FRAME;
        bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
        Frame::decode(&bytes).unwrap_err()
    };
    // Number of arrays, a name's length, a rank, an extent: huge or merely wrong.
    for value in [u64::MAX, u64::MAX / 4, 1 << 40, 1 << 20] {
        for at in [16, 24, 37, 45, 53] {
            with_u64(at, value);
        }
    }
    assert_eq!(with_u64(45, u64::MAX), FrameError::Overflow("a".to_owned()));
    assert!(matches!(with_u64(45, 1 << 20), FrameError::Length { .. }));
    assert_eq!(Frame::decode(b"GIF89a").unwrap_err(), FrameError::Magic);
}

#[test]
fn frames_that_break_a_limit_are_not_encoded() {
    let one = |name: String| Array::f32(name, [1], vec![0.0f32]);
    let frame = |arrays| Frame { generation: 0, arrays }.encode().unwrap_err();
    let many = (0..=frame::MAX_ARRAYS).map(|i| one(i.to_string())).collect();
    assert!(matches!(frame(many), FrameError::TooMany { .. }));
    let long = vec![one("x".repeat(frame::MAX_NAME_BYTES + 1))];
    assert!(matches!(frame(long), FrameError::TooMany { .. }));
    let deep = vec![Array::f32("x", [1; frame::MAX_RANK + 1], vec![0.0f32])];
    assert!(matches!(frame(deep), FrameError::TooMany { .. }));
    let twins = vec![one("x".to_owned()), one("x".to_owned())];
    assert_eq!(frame(twins), FrameError::Duplicate("x".to_owned()));
    let ragged = vec![Array::f32("x", [2], vec![0.0f32])];
    assert!(matches!(frame(ragged), FrameError::Shape { .. }));
}

#[test]
fn the_largest_header_fits() {
    let arrays = (0..frame::MAX_ARRAYS)
        .map(|i| Array::u32(format!("{i:064}"), [1; frame::MAX_RANK], vec![i as u32]))
        .collect();
    let frame = Frame { generation: u64::MAX, arrays };
    let bytes = frame.encode().unwrap();
    assert_eq!(Frame::decode(&bytes).unwrap(), frame);
}

#[test]
fn arrays_are_taken_by_name() {
    let mut frame = small_frame();
    assert_eq!(frame.take("w").unwrap().data.dtype(), DType::F64);
    let missing = frame.take("w").unwrap_err();
    assert_eq!(missing.to_string(), "array \"w\" is missing, expected present");
}

/// `numpy.save` of `numpy.array([[1, 2, 0.5]], '<f4')`.
fn npy_file() -> Vec<u8> {
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (1, 3), }";
    let mut bytes = b"\x93NUMPY\x01\0\x76\0".to_vec();
    bytes.extend(format!("{header:<117}\n").bytes());
    bytes.extend(b"\0\0\x80\x3f\0\0\0\x40\0\0\0\x3f");
    bytes
}

#[test]
fn npy_is_what_numpy_writes() {
    let array = Array::f32("a", [1, 3], vec![1.0f32, 2.0, 0.5]);
    assert_eq!(npy::encode(&array).unwrap(), npy_file());
    assert_eq!(npy::decode("a", &npy_file()).unwrap(), array);
}

#[test]
fn npy_handles_every_rank() {
    for shape in [vec![], vec![3], vec![2, 0, 4], vec![1; npy::MAX_RANK]] {
        let n = shape.iter().product();
        let array = Array::f64("a", shape, vec![1.5; n]);
        let bytes = npy::encode(&array).unwrap();
        assert_eq!((bytes.len() - 8 * n) % 64, 0);
        assert_eq!(npy::decode("a", &bytes).unwrap(), array);
    }
    let text =
        String::from_utf8_lossy(&npy::encode(&Array::f32("a", [3], vec![0.0f32; 3])).unwrap())
            .into_owned();
    assert!(text.contains("'shape': (3,), }"), "{text}");
}

#[test]
fn npy_refuses_what_it_does_not_speak() {
    let numbers = Array::u32("t", [1, 2], vec![1, u32::MAX]);
    assert_eq!(npy::decode("t", &npy::encode(&numbers).unwrap()).unwrap(), numbers);
    let file = npy_file();
    for length in 0..file.len() {
        assert!(npy::decode("a", &file[..length]).is_err(), "{length} bytes");
    }
    let changed = |from: &str, to: &str| {
        let mut bytes = npy_file();
        let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
        bytes[at..at + from.len()].copy_from_slice(to.as_bytes());
        npy::decode("a", &bytes).unwrap_err()
    };
    assert!(matches!(changed("<f4", ">f4"), NpyError::Header(_)));
    assert!(matches!(changed("<f4", "<i4"), NpyError::Header(_)));
    assert!(matches!(changed("False", "True "), NpyError::Header(_)));
    assert!(matches!(changed("(1, 3)", "(1  3)"), NpyError::Header(_)));
    assert!(matches!(changed("(1, 3), }", "(1,3,9), "), NpyError::Header(_)));
    assert!(matches!(changed("(1, 3), }  ", "(9, 99), } "), NpyError::Length { .. }));
    let huge = "(18446744073709551615, 3), }";
    assert!(matches!(
        changed(&format!("(1, 3), }}{}", " ".repeat(19)), huge),
        NpyError::Length { .. }
    ));
}

#[test]
fn a_state_frame_has_these_bytes() {
    let frame = StateFrame {
        sequence: 1,
        time_s: 0.5,
        generation: 2,
        rigid: RIGID_IDENTITY,
        q: vec![1.0, -2.0],
    };
    let mut bytes = Vec::new();
    bytes.extend([1, 0, 0, 0, 0, 0, 0, 0]);
    bytes.extend([0, 0, 0, 0, 0, 0, 0xe0, 0x3f]);
    bytes.extend([2, 0, 0, 0, 0, 0, 0, 0]);
    bytes.extend([0; 48]);
    bytes.extend([0, 0, 0, 0, 0, 0, 0xf0, 0x3f]);
    bytes.extend([2, 0, 0, 0]);
    bytes.extend([0, 0, 0x80, 0x3f, 0, 0, 0, 0xc0]);
    assert_eq!(frame.encode().unwrap(), bytes);
    assert_eq!(StateFrame::decode(&bytes).unwrap(), frame);
    for length in 0..bytes.len() {
        assert!(StateFrame::decode(&bytes[..length]).is_err(), "{length} bytes");
    }
    let mut hostile = bytes.clone();
    hostile[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(matches!(StateFrame::decode(&hostile), Err(StateFrameError::Length { .. })));
    let mut infinite = bytes;
    infinite[84..88].copy_from_slice(&f32::INFINITY.to_le_bytes());
    assert_eq!(StateFrame::decode(&infinite), Err(StateFrameError::NonFinite));
    let long = StateFrame { q: vec![0.0; MAX_BASIS_SIZE + 1], ..frame };
    assert!(matches!(long.encode(), Err(StateFrameError::TooLong(_))));
}

#[test]
fn keys_are_built_and_taken_apart() {
    assert_eq!(keys::session("a-1_B", Resource::Edits).unwrap(), "sutura/v1/sessions/a-1_B/edits");
    for resource in Resource::ALL {
        let key = keys::session("x7", resource).unwrap();
        assert_eq!(keys::parse_session(&key), Some(("x7", resource)));
    }
    assert_eq!(keys::every_session(Resource::Info), "sutura/v1/sessions/*/info");
    assert_eq!(keys::parse_daemon(&keys::daemon("d1").unwrap()), Some("d1"));
    for id in ["", "*", "a/b", "a b", "ä", "$*", "?", "#", &"x".repeat(65)] {
        assert_eq!(keys::session(id, Resource::State), None, "{id:?}");
        assert_eq!(keys::daemon(id), None, "{id:?}");
    }
    for key in [
        "sutura/v1/sessions/*/edits",
        "sutura/v1/sessions/a/nothing",
        "sutura/v1/sessions/a/edits/more",
        "sutura/v1/sessions//edits",
        "sutura/v1/sessions/a",
        "sutura/v2/sessions/a/edits",
        "sutura/v1",
        "",
    ] {
        assert_eq!(keys::parse_session(key), None, "{key:?}");
    }
}

proptest! {
    #[test]
    fn frames_round_trip(
        generation: u64,
        a in prop::collection::vec(any::<u32>(), 0..40),
        b in prop::collection::vec(-1e300..1e300f64, 0..20),
    ) {
        let arrays = vec![
            Array::u32("tets", [a.len()], a),
            Array::f64("weights", [1, b.len()], b),
        ];
        let frame = Frame { generation, arrays };
        let bytes = frame.encode().unwrap();
        prop_assert_eq!(Frame::decode(&bytes).unwrap(), frame);
    }

    #[test]
    fn decoders_never_panic(mut bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = StateFrame::decode(&bytes);
        let _ = npy::decode("x", &bytes);
        let _ = sutura_proto::bus::decode::<sutura_proto::edit::EditRequest>(&bytes);
        let n = bytes.len().min(8);
        bytes[..n].copy_from_slice(&frame::MAGIC[..n]);
        let _ = Frame::decode(&bytes);
    }

    #[test]
    fn flipping_any_byte_of_a_frame_never_panics(at in 0..SMALL_FRAME.len(), to: u8) {
        let mut bytes = SMALL_FRAME;
        bytes[at] = to;
        let _ = Frame::decode(&bytes);
    }

    #[test]
    fn states_round_trip(
        sequence: u64,
        time_s in 0.0..1e9f64,
        q in prop::collection::vec(-1e30..1e30f32, 0..90),
    ) {
        let frame = StateFrame { sequence, time_s, generation: 3, rigid: RIGID_IDENTITY, q };
        let bytes = frame.encode().unwrap();
        prop_assert_eq!(bytes.len(), HEADER_BYTES + 4 * frame.q.len());
        prop_assert_eq!(StateFrame::decode(&bytes).unwrap(), frame);
    }
}
