//! The arrays of a generation as bytes. Everything here takes as long as the arrays are large: for
//! the query pool.

use crate::problem::{Kind, Problem};
use sutura_core::build::{Artifacts, BlockName};
use sutura_core::control::{self, Control};
use sutura_proto::array::{Array, DType};
use sutura_proto::frame::Frame;
use sutura_proto::generation as names;
use sutura_proto::{media, npy};
use sutura_store::{Generation, StoreError};

/// What can be fetched of a generation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ArrayKind {
    Modes,
    Basis,
    Transfer,
    Delta,
    Combination,
    Dictionary,
    Evaluator,
    Mass,
    FrequenciesHz,
    Positions,
    Tets,
    Stitches,
}

impl ArrayKind {
    /// Media types it can travel as, the preferred one first.
    pub(crate) fn offered(self) -> &'static [&'static str] {
        match self {
            ArrayKind::Delta
            | ArrayKind::Combination
            | ArrayKind::Evaluator
            | ArrayKind::Stitches => &[media::FRAME],
            _ => &[media::NPY, media::FRAME],
        }
    }

    /// How it relates to another generation.
    pub(crate) fn reference(self) -> Reference {
        match self {
            ArrayKind::Transfer => Reference::PreviousUnlessGiven,
            ArrayKind::Delta => Reference::Required,
            _ => Reference::None,
        }
    }
}

/// Whether an array depends on a second generation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reference {
    None,
    PreviousUnlessGiven,
    Required,
}

/// `kind` of `generation` (relative to `reference`, where it depends on one; of `blocks`, where it
/// consists of some) as bytes.
pub(crate) fn encode(
    kind: ArrayKind,
    generation: &Generation,
    reference: Option<&Generation>,
    blocks: &[u64],
    form: ArrayForm,
    control: &dyn Control,
) -> Result<Vec<u8>, Problem> {
    let arrays = assemble(kind, &generation.artifacts, reference, blocks, form, control)?;
    let encoded = match (form.media, &arrays[..]) {
        (media::NPY, [array]) => npy::encode(array).map_err(|error| error.to_string()),
        _ => Frame { generation: generation.number, arrays }
            .encode()
            .map_err(|error| error.to_string()),
    };
    encoded.map_err(|error| Problem::new(Kind::Internal, error))
}

fn assemble(
    kind: ArrayKind,
    artifacts: &Artifacts,
    reference: Option<&Generation>,
    blocks: &[u64],
    form: ArrayForm,
    control: &dyn Control,
) -> Result<Vec<Array<'static>>, Problem> {
    let n_vertices = artifacts.mesh().vertices().len();
    let r = artifacts.basis_size();
    let old = || {
        reference
            .map(|generation| &*generation.artifacts)
            .ok_or_else(|| Problem::new(Kind::Internal, "no generation to relate to"))
    };
    let array = |name, shape: &[usize], values: &[f64]| {
        let mut elements = form.elements(name, values.len())?;
        elements.extend(name, values)?;
        Ok::<_, Problem>(elements.into_array(name, shape))
    };
    let columns = |name, n, column: &dyn Fn(usize) -> Vec<f64>| {
        let mut elements = form.elements(name, n * 3 * n_vertices)?;
        for i in 0..n {
            control::check(control).map_err(|_| StoreError::Cancelled)?;
            elements.extend(name, &column(i))?;
        }
        Ok::<_, Problem>(elements.into_array(name, &[n, n_vertices, 3]))
    };
    Ok(match kind {
        ArrayKind::Modes => {
            vec![columns(names::MODES, artifacts.n_modes(), &|i| artifacts.mode(i))?]
        }
        ArrayKind::Basis => vec![columns(names::BASIS, r, &|i| artifacts.basis_column(i))?],
        ArrayKind::Mass => vec![array(names::MASS, &[n_vertices], artifacts.lumped_mass_kg())?],
        ArrayKind::FrequenciesHz => {
            let frequencies = artifacts.frequencies_hz();
            vec![array(names::FREQUENCIES_HZ, &[frequencies.len()], &frequencies)?]
        }
        ArrayKind::Positions => {
            let positions = artifacts.mesh().vertices().as_flattened();
            vec![array(names::POSITIONS, &[n_vertices, 3], positions)?]
        }
        ArrayKind::Tets => {
            let tets = artifacts.mesh().tets();
            form.room(names::TETS, 4 * tets.len(), size_of::<u32>())?;
            vec![Array::u32(names::TETS, [tets.len(), 4], tets.as_flattened().to_vec())]
        }
        ArrayKind::Stitches => {
            let stitches = artifacts.stitches();
            let n = stitches.len();
            let pairs: Vec<u32> = stitches.iter().flat_map(|stitch| stitch.pair).collect();
            let stiffness: Vec<f64> = stitches.iter().map(|stitch| stitch.stiffness_n_m).collect();
            vec![
                Array::u32(names::STITCHES_PAIRS, [n, 2], pairs),
                id_halves(names::STITCHES_IDS, stitches.iter().map(|stitch| stitch.id)),
                array(names::STITCHES_STIFFNESS_N_M, &[n], &stiffness)?,
            ]
        }
        ArrayKind::Transfer => {
            let old = old()?;
            let transfer = artifacts.transfer_from(old);
            vec![array(names::TRANSFER, &[r, old.basis_size()], &transfer)?]
        }
        ArrayKind::Delta => {
            let old = old()?;
            let delta = artifacts
                .delta_from(old)
                .map_err(|error| Problem::new(Kind::Internal, error.to_string()))?;
            let n = delta.columns.len();
            vec![
                columns(names::DELTA_COLUMNS, n, &|i| delta.columns[i].clone())?,
                array(names::DELTA_W, &[old.basis_size() + n, r], &delta.w)?,
            ]
        }
        ArrayKind::Combination => {
            let combination = artifacts.basis_combination();
            let prepared = artifacts.prepared_blocks();
            let p = combination.columns.len();
            let used = numbers(combination.columns.iter().copied());
            vec![
                Array::u32(names::COMBINATION_N_VERTICES, [1], numbers([n_vertices])),
                block_ids(names::COMBINATION_BLOCKS, &combination.blocks),
                block_sizes(names::COMBINATION_BLOCK_SIZES, &combination.blocks),
                Array::u32(names::COMBINATION_COLUMNS, [p], used),
                array(names::COMBINATION_W, &[p, r], &combination.w)?,
                block_ids(names::COMBINATION_PREPARED, &prepared),
                block_sizes(names::COMBINATION_PREPARED_SIZES, &prepared),
            ]
        }
        ArrayKind::Dictionary => vec![dictionary(artifacts, blocks, form, control)?],
        ArrayKind::Evaluator => {
            let tables = artifacts.evaluator_tables();
            let p = tables.tets.len();
            vec![
                Array::u32(names::EVALUATOR_TETS, [p], tables.tets),
                array(names::EVALUATOR_WEIGHTS, &[p], &tables.weights)?,
                array(names::EVALUATOR_VOLUMES_M3, &[p], &tables.volumes_m3)?,
                array(names::EVALUATOR_LAME_PA, &[p, 2], &tables.lame_pa)?,
                array(names::EVALUATOR_SHAPE_GRADIENTS, &[p, 4, 3], &tables.shape_gradients)?,
                array(names::EVALUATOR_BASIS_ROWS, &[p, 4, 3, tables.r], &tables.basis_rows)?,
                array(
                    names::EVALUATOR_STITCH_STIFFNESS,
                    &[tables.r, tables.r],
                    &tables.stitch_stiffness,
                )?,
                Array::u32(names::EVALUATOR_LAWS, [p], tables.laws),
                array(names::EVALUATOR_MOONEY_RATIOS, &[p], &tables.mooney_ratios)?,
                array(names::EVALUATOR_GRAVITY_LOADS, &[tables.r, 3], &tables.gravity_loads)?,
                array(
                    names::EVALUATOR_DAMPING,
                    &[2],
                    &[tables.damping.mass_per_s, tables.damping.stiffness_s],
                )?,
            ]
        }
    })
}

/// The columns of `blocks`, one block after the other.
fn dictionary(
    artifacts: &Artifacts,
    blocks: &[u64],
    form: ArrayForm,
    control: &dyn Control,
) -> Result<Array<'static>, Problem> {
    let found = blocks.iter().map(|&id| {
        artifacts.block_columns(id).ok_or_else(|| {
            let detail = format!("this generation and its body have no block {id}");
            Problem::new(Kind::NoBlock, detail)
        })
    });
    let found: Vec<_> = found.collect::<Result<_, _>>()?;
    let n_vertices = artifacts.mesh().vertices().len();
    let n: usize = found.iter().map(|columns| columns.len()).sum();
    let mut elements = form.elements(names::DICTIONARY, n * 3 * n_vertices)?;
    for column in found.into_iter().flatten() {
        control::check(control).map_err(|_| StoreError::Cancelled)?;
        elements.extend(names::DICTIONARY, &column)?;
    }
    Ok(elements.into_array(names::DICTIONARY, &[n, n_vertices, 3]))
}

/// Names of blocks.
fn block_ids(name: &'static str, blocks: &[BlockName]) -> Array<'static> {
    id_halves(name, blocks.iter().map(|block| block.id))
}

/// The two halves of each number, the lower one first.
fn id_halves(name: &'static str, ids: impl ExactSizeIterator<Item = u64>) -> Array<'static> {
    let n = ids.len();
    let halves: Vec<u32> = ids.flat_map(|id| [id as u32, (id >> 32) as u32]).collect();
    Array::u32(name, [n, 2], halves)
}

/// Columns of each block.
fn block_sizes(name: &'static str, blocks: &[BlockName]) -> Array<'static> {
    Array::u32(name, [blocks.len()], numbers(blocks.iter().map(|block| block.n_columns)))
}

/// Counts, which limits keep far below what 32 bits hold.
fn numbers(counts: impl IntoIterator<Item = usize>) -> Vec<u32> {
    counts.into_iter().map(|count| count as u32).collect()
}

/// How arrays travel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ArrayForm {
    /// Type of floating-point elements.
    pub(crate) dtype: DType,
    /// Media type.
    pub(crate) media: &'static str,
    /// Largest array that may be sent.
    pub(crate) max_bytes: usize,
}

impl ArrayForm {
    /// Room for `n` elements, unless they would be too many bytes.
    fn elements(self, name: &str, n: usize) -> Result<Elements, Problem> {
        self.room(name, n, self.dtype.size())?;
        Ok(Elements::with_capacity(self.dtype, n))
    }

    /// Refuses `n` elements of `size` bytes each if they are too many bytes.
    fn room(self, name: &str, n: usize, size: usize) -> Result<(), Problem> {
        let n_bytes = n.saturating_mul(size);
        if n_bytes > self.max_bytes {
            let limit = self.max_bytes;
            let detail = format!("{name} has {n_bytes} bytes, at most {limit} are sent at once");
            return Err(Problem::new(Kind::TooLarge, detail));
        }
        Ok(())
    }
}

/// Elements of an array in the type that the client asked for.
enum Elements {
    F32(Vec<f32>),
    F64(Vec<f64>),
}

impl Elements {
    fn with_capacity(dtype: DType, n: usize) -> Elements {
        match dtype {
            DType::F64 => Elements::F64(Vec::with_capacity(n)),
            DType::F32 | DType::U32 => Elements::F32(Vec::with_capacity(n)),
        }
    }

    /// Appends `values`; refuses to let an overflow or a NaN out.
    fn extend(&mut self, name: &str, values: &[f64]) -> Result<(), Problem> {
        let finite = match self {
            Elements::F32(elements) => {
                elements.extend(values.iter().map(|&x| x as f32));
                elements[elements.len() - values.len()..].iter().all(|x| x.is_finite())
            }
            Elements::F64(elements) => {
                elements.extend_from_slice(values);
                values.iter().all(|x| x.is_finite())
            }
        };
        match (finite, values.iter().all(|x| x.is_finite())) {
            (true, _) => Ok(()),
            (false, true) => {
                let detail = format!("{name} holds numbers beyond f32: ask for dtype=f64");
                Err(Problem::new(Kind::ImpossibleValue, detail))
            }
            (false, false) => {
                let detail = format!("{name} holds a number that is not finite");
                Err(Problem::new(Kind::Internal, detail))
            }
        }
    }

    fn into_array(self, name: &'static str, shape: &[usize]) -> Array<'static> {
        match self {
            Elements::F32(elements) => Array::f32(name, shape, elements),
            Elements::F64(elements) => Array::f64(name, shape, elements),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_arrays_travel_both_ways_and_tables_as_frames() {
        for kind in [
            ArrayKind::Modes,
            ArrayKind::Basis,
            ArrayKind::Transfer,
            ArrayKind::Dictionary,
            ArrayKind::Mass,
            ArrayKind::FrequenciesHz,
            ArrayKind::Positions,
            ArrayKind::Tets,
        ] {
            assert_eq!(kind.offered(), [media::NPY, media::FRAME]);
        }
        for kind in
            [ArrayKind::Delta, ArrayKind::Combination, ArrayKind::Evaluator, ArrayKind::Stitches]
        {
            assert_eq!(kind.offered(), [media::FRAME]);
        }
    }

    #[test]
    fn arrays_beyond_the_limit_are_refused_before_they_are_made() {
        let form = ArrayForm { dtype: DType::F64, media: media::NPY, max_bytes: 16 };
        assert!(form.elements("x", 2).is_ok());
        for n in [3, usize::MAX] {
            assert_eq!(form.elements("x", n).err().unwrap().status(), 413);
        }
    }

    #[test]
    fn numbers_that_do_not_fit_are_refused_rather_than_sent() {
        let mut elements = Elements::with_capacity(DType::F32, 2);
        elements.extend("x", &[1.0, 2.0]).unwrap();
        assert_eq!(elements.extend("x", &[1e39]).unwrap_err().status(), 422);
        let mut elements = Elements::with_capacity(DType::F64, 2);
        elements.extend("x", &[1e39]).unwrap();
        assert_eq!(elements.extend("x", &[f64::NAN]).unwrap_err().status(), 500);
    }
}
