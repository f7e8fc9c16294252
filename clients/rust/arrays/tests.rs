use super::*;
use crate::Tracker;
use sutura_proto::array::Array as WireArray;
use sutura_proto::state::{RIGID_IDENTITY, StateFrame};

/// Two vertices. Generation 0 has two columns; generation 1 replaces the second one by a new column
/// and adds half of the first. The columns of generation 0 are block 1, the new column is block 2, of
/// which a first column takes no part.
struct Daemon {
    /// Whether it has the generation before and the blocks still.
    keeps_old: bool,
}

const OLD: [f32; 12] = [1., 0., 0., 0., 0., 2., 0., 1., 0., 0., 3., 0.];
const EXTRA: [f32; 6] = [0., 0., 5., 5., 0., 0.];
const NEW: [f32; 12] = [1., 0., 0., 0., 0., 2., 0.5, 0., 5., 5., 0., 1.];

impl Arrays for Daemon {
    async fn frame(&self, query: Query) -> Result<Vec<u8>> {
        let generation = if let Generation::Number(number) = query.generation { number } else { 0 };
        let arrays = match (query.resource, generation) {
            (Resource::Basis, 0) => vec![WireArray::f32(BASIS, [2, 2, 3], &OLD[..])],
            (Resource::Basis, _) => vec![WireArray::f32(BASIS, [2, 2, 3], &NEW[..])],
            (Resource::Combination, 0) => combination(&[(1, 2)], &[0, 1], &[1., 0., 0., 1.]),
            (Resource::Combination, _) => {
                combination(&[(1, 2), (BIG, 2)], &[0, 3], &[1.0, 0.5, 0.0, 1.0])
            }
            (Resource::Dictionary, _) if self.keeps_old => match &*query.parameters()[1].1 {
                "1" => vec![WireArray::f32(DICTIONARY, [2, 2, 3], &OLD[..])],
                _ => vec![WireArray::f32(DICTIONARY, [2, 2, 3], [[9.0; 6], EXTRA].concat())],
            },
            (Resource::Transfer, _) if self.keeps_old => {
                vec![WireArray::f32(TRANSFER, [2, 2], vec![1.0, 0.0, 0.5, 0.0])]
            }
            (Resource::Delta, _) if self.keeps_old => vec![
                WireArray::f32(DELTA_W, [3, 2], vec![1.0, 0.5, 0.0, 0.0, 0.0, 1.0]),
                WireArray::f32(DELTA_COLUMNS, [1, 2, 3], &EXTRA[..]),
            ],
            _ => {
                let problem = sutura_proto::Problem {
                    kind: "about:blank".to_owned(),
                    title: "Not found".to_owned(),
                    status: 404,
                    detail: "no such generation".to_owned(),
                    instance_pointer: None,
                };
                return Err(Error::Problem(Box::new(problem)));
            }
        };
        Ok(Frame { generation, arrays }.encode()?)
    }
}

/// A name beyond 32 bits.
const BIG: u64 = 2 + (3 << 32);

/// The arrays of a combination of `blocks` (name and size).
fn combination(blocks: &[(u64, u32)], used: &[u32], w: &[f32]) -> Vec<WireArray<'static>> {
    let ids: Vec<u32> = blocks.iter().flat_map(|(id, _)| [*id as u32, (id >> 32) as u32]).collect();
    let sizes: Vec<u32> = blocks.iter().map(|(_, size)| *size).collect();
    let n = blocks.len();
    vec![
        WireArray::u32(COMBINATION_N_VERTICES, [1], vec![2]),
        WireArray::u32(COMBINATION_BLOCKS, [n, 2], ids.clone()),
        WireArray::u32(COMBINATION_BLOCK_SIZES, [n], sizes.clone()),
        WireArray::u32(COMBINATION_COLUMNS, [used.len()], used.to_vec()),
        WireArray::f32(COMBINATION_W, [used.len(), w.len() / used.len()], w.to_vec()),
        WireArray::u32(COMBINATION_PREPARED, [n, 2], ids),
        WireArray::u32(COMBINATION_PREPARED_SIZES, [n], sizes),
    ]
}

#[tokio::test]
async fn displacements_are_combinations_of_columns() {
    let basis: Basis = Daemon { keeps_old: true }.basis(Generation::Current).await.unwrap();
    assert_eq!((basis.generation(), basis.size(), basis.n_vertices()), (0, 2, 2));
    assert_eq!(basis.column(1), &OLD[6..]);
    assert!(basis.column(2).is_empty());
    let displacement = basis.reconstruct(&[2.0, -1.0]).unwrap();
    assert_eq!(displacement, [2.0, -1.0, 0.0, 0.0, -3.0, 4.0]);
    assert!(matches!(basis.reconstruct(&[1.0]), Err(Error::Mismatch(_))));
}

#[tokio::test]
async fn a_tracker_follows_with_or_without_the_old_generation() {
    for keeps_old in [true, false] {
        let mut tracker = Tracker::new(Daemon { keeps_old }).await.unwrap();
        let mut state = StateFrame {
            sequence: 1,
            time_s: 0.0,
            generation: 0,
            rigid: RIGID_IDENTITY,
            q: vec![0.0, 1.0],
        };
        assert_eq!(tracker.displacement(&state).await.unwrap(), &OLD[6..]);
        state.generation = 1;
        assert_eq!(tracker.displacement(&state).await.unwrap(), &NEW[6..]);
        assert_eq!(tracker.generation(), 1);
        assert_eq!(tracker.basis().unwrap().column(1), &NEW[6..]);
        let held: Vec<u64> = tracker.dictionary().ids().collect();
        assert_eq!(held, if keeps_old { vec![1, BIG] } else { vec![] });
        state.q.push(0.0);
        assert!(matches!(tracker.displacement(&state).await, Err(Error::Mismatch(_))));
    }
}

#[tokio::test]
async fn a_tracker_holds_no_more_columns_than_it_may() {
    const COLUMN: usize = 6 * 4;
    for (limit, first, second) in [
        (4 * COLUMN, vec![1], vec![1, BIG]),
        // Generation 1 is combined of four columns, all of which would have to be held.
        (3 * COLUMN, vec![1], vec![1]),
        (COLUMN, vec![], vec![]),
    ] {
        let mut tracker = Tracker::with_limit(Daemon { keeps_old: true }, limit).await.unwrap();
        assert_eq!(tracker.dictionary().ids().collect::<Vec<_>>(), first);
        for generation in [1, 0, 1] {
            tracker.follow(generation).await.unwrap();
            assert!(tracker.dictionary().bytes() <= limit);
            let columns = if generation == 0 { &OLD } else { &NEW };
            assert_eq!(tracker.reconstruct(&[0.0, 1.0]).unwrap(), &columns[6..]);
        }
        assert_eq!(tracker.dictionary().ids().collect::<Vec<_>>(), second);
        assert_eq!(tracker.prefetch().await.unwrap(), limit >= 2 * COLUMN);
        assert!(tracker.dictionary().bytes() <= limit);
    }
}

#[tokio::test]
async fn combinations_are_consistent_or_refused() {
    let good = || combination(&[(1, 2), (2, 2)], &[0, 3], &[1.0, 0.5, 0.0, 1.0]);
    let decode = async |arrays| Hostile(arrays).combination::<f32>(0.into()).await;
    let combined = decode(good()).await.unwrap();
    assert_eq!((combined.size(), combined.n_columns(), combined.n_vertices()), (2, 4, 2));
    // Not held, and held of another mesh.
    let mut dictionary = Dictionary::default();
    assert!(matches!(dictionary.basis(&combined), Err(Error::Mismatch(_))));
    for (id, n_vertices) in [(1, 2), (2, 1)] {
        let shape = vec![2, n_vertices, 3];
        let data = vec![0.0; 6 * n_vertices];
        dictionary.insert(id, Array { generation: 0, shape, data });
    }
    assert!(matches!(dictionary.reconstruct(&combined, &[0.0; 2]), Err(Error::Mismatch(_))));

    let changed = |name: &str, array: WireArray<'static>| {
        let mut arrays = good();
        *arrays.iter_mut().find(|array| array.name == name).unwrap() = array;
        arrays
    };
    let u32s = |name: &'static str, shape: &[usize], data: &[u32]| {
        changed(name, WireArray::u32(name, shape, data.to_vec()))
    };
    for arrays in [
        u32s(COMBINATION_N_VERTICES, &[2], &[2, 2]),
        u32s(COMBINATION_BLOCKS, &[1, 2], &[1, 0]),
        u32s(COMBINATION_BLOCKS, &[2, 2], &[1, 0, 1, 0]),
        u32s(COMBINATION_BLOCK_SIZES, &[2], &[u32::MAX, 2]),
        u32s(COMBINATION_BLOCK_SIZES, &[3], &[2, 1, 1]),
        u32s(COMBINATION_COLUMNS, &[2], &[0, 4]),
        u32s(COMBINATION_COLUMNS, &[2], &[3, 0]),
        u32s(COMBINATION_COLUMNS, &[2], &[3, 3]),
        u32s(COMBINATION_COLUMNS, &[3], &[0, 1, 3]),
        u32s(COMBINATION_COLUMNS, &[0], &[]),
        u32s(COMBINATION_PREPARED, &[0, 2], &[]),
        changed(COMBINATION_W, WireArray::f32(COMBINATION_W, [2, 0], vec![])),
        changed(COMBINATION_W, WireArray::f32(COMBINATION_W, [2, 4], vec![0.0; 8])),
        changed(COMBINATION_W, WireArray::f64(COMBINATION_W, [2, 2], vec![0.0; 4])),
        changed(COMBINATION_COLUMNS, WireArray::f32(COMBINATION_COLUMNS, [2], vec![0.0, 3.0])),
    ] {
        let shown = format!("{arrays:?}");
        assert!(matches!(decode(arrays).await, Err(Error::Decode(_))), "{shown}");
    }
}

#[tokio::test]
async fn transfers_carry_coordinates_over() {
    let transfer: Transfer = Daemon { keeps_old: true }.transfer(1.into(), 0).await.unwrap();
    assert_eq!(transfer.apply(&[2.0, 7.0]).unwrap(), [2.0, 1.0]);
    assert!(matches!(transfer.apply(&[2.0]), Err(Error::Mismatch(_))));
}

#[tokio::test]
async fn a_delta_of_another_basis_is_refused() {
    let daemon = Daemon { keeps_old: true };
    let basis: Basis = daemon.basis(1.into()).await.unwrap();
    let delta = daemon.delta(1.into(), 0).await.unwrap();
    assert!(matches!(basis.updated(&delta), Err(Error::Mismatch(_))));
}

/// Answers every query with the same frame.
struct Hostile(Vec<WireArray<'static>>);

impl Arrays for Hostile {
    async fn frame(&self, _query: Query) -> Result<Vec<u8>> {
        Ok(Frame { generation: 0, arrays: self.0.clone() }.encode()?)
    }
}

#[tokio::test]
async fn hostile_shapes_are_refused() {
    const HUGE: usize = 1 << 60;
    for shape in [vec![0, HUGE, 3], vec![HUGE, 0, 3], vec![1, 0, 3]] {
        let hostile = Hostile(vec![WireArray::f32(BASIS, shape, vec![])]);
        assert!(matches!(hostile.basis::<f32>(0.into()).await, Err(Error::Decode(_))));
    }
    for shape in [vec![0, HUGE], vec![HUGE, 0]] {
        let hostile = Hostile(vec![WireArray::f32(TRANSFER, shape, vec![])]);
        assert!(matches!(hostile.transfer::<f32>(0.into(), 0).await, Err(Error::Decode(_))));
    }
    let wrong = [
        WireArray::f32(BASIS, [6], vec![0.0; 6]),
        WireArray::f32(BASIS, [1, 3, 2], vec![0.0; 6]),
        WireArray::f64(BASIS, [1, 2, 3], vec![0.0; 6]),
        WireArray::f32("base", [1, 2, 3], vec![0.0; 6]),
    ];
    for array in wrong {
        let hostile = Hostile(vec![array]);
        assert!(matches!(hostile.basis::<f32>(0.into()).await, Err(Error::Decode(_))));
    }
    // A delta that claims no columns, but of a huge mesh; one that would make many from few.
    let basis: Basis = Daemon { keeps_old: true }.basis(0.into()).await.unwrap();
    let w = WireArray::f32(DELTA_W, [2, 2], vec![1.0, 0.0, 0.0, 1.0]);
    let columns = WireArray::f32(DELTA_COLUMNS, [0, HUGE, 3], vec![]);
    let delta = Hostile(vec![w, columns.clone()]).delta(0.into(), 0).await.unwrap();
    assert_eq!(basis.updated(&delta).unwrap(), basis);
    let wide = WireArray::f32(DELTA_W, [2, 4096], vec![0.0; 8192]);
    let delta = Hostile(vec![wide, columns]).delta(0.into(), 0).await.unwrap();
    assert!(matches!(basis.updated(&delta), Err(Error::Mismatch(_))));
}

#[tokio::test]
async fn evaluators_are_consistent_or_refused() {
    let (p, r) = (2, 3);
    let mut arrays = vec![
        WireArray::u32(EVALUATOR_TETS, [p], vec![4, 7]),
        WireArray::f64(EVALUATOR_WEIGHTS, [p], vec![1.0; p]),
        WireArray::f64(EVALUATOR_VOLUMES_M3, [p], vec![1.0; p]),
        WireArray::f64(EVALUATOR_LAME_PA, [p, 2], vec![1.0; 2 * p]),
        WireArray::f64(EVALUATOR_SHAPE_GRADIENTS, [p, 4, 3], vec![1.0; 12 * p]),
        WireArray::f64(EVALUATOR_BASIS_ROWS, [p, 4, 3, r], vec![1.0; 12 * p * r]),
        WireArray::f64(EVALUATOR_STITCH_STIFFNESS, [r, r], vec![1.0; r * r]),
        WireArray::u32(EVALUATOR_LAWS, [p], vec![1; p]),
        WireArray::f64(EVALUATOR_MOONEY_RATIOS, [p], vec![0.0; p]),
        WireArray::f64(EVALUATOR_GRAVITY_LOADS, [r, 3], vec![1.0; 3 * r]),
        WireArray::f64(EVALUATOR_DAMPING, [2], vec![0.1, 0.001]),
    ];
    let evaluator: Evaluator<f64> = Hostile(arrays.clone()).evaluator(0.into()).await.unwrap();
    assert_eq!(evaluator.tets, [4, 7]);
    arrays[1] = WireArray::f64(EVALUATOR_WEIGHTS, [p + 1], vec![1.0; p + 1]);
    let evaluator = Hostile(arrays).evaluator::<f64>(0.into()).await;
    assert!(matches!(evaluator, Err(Error::Decode(_))));
}
