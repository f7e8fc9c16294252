//! What is kept of prepared bodies, as bytes: a record that says what they are, and behind it, each with a checksum
//! of its own ([`frame`]), the matrices of the mesh's size, as little-endian numbers column by column.
//!
//! They are named for what they are a function of: whoever looks for a body finds it or nothing.

use super::frame::{self, Digest};
use super::generation::RecipeRecord;
use super::record::{self, ParamsRecord, Unreadable};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::time::Duration;
use sutura_core::build::{
    BaseSnapshot, Columns, CubatureReport, CubatureSnapshot, CubatureSource, GenerationSnapshot,
    Verdict,
};
use sutura_core::control::Stage;
use sutura_core::cubature::{Rule, Smoothing};
use sutura_core::modes::AuditedSpectrum;

/// Numbers may differ in their last bits from one version of this program to the next: what one keeps, another does
/// not look for.
const PROGRAM: &str = env!("CARGO_PKG_VERSION");

/// What a generation's base body and the generation itself are kept under.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct BodyNames {
    pub(crate) base: Digest,
    pub(crate) own: Digest,
}

#[derive(Serialize)]
enum Name<'a> {
    Base {
        program: &'a str,
        params: &'a Digest,
        mesh: &'a Digest,
        fixed_vertices: &'a [u32],
        stiffness_factors: &'a [(i64, f64)],
        folded: &'a [([u32; 2], f64)],
    },
    Generation {
        program: &'a str,
        params: &'a Digest,
        recipe: &'a RecipeRecord,
    },
}

impl Name<'_> {
    fn digest(&self) -> Result<Digest, Unreadable> {
        record::encode(self).map(|bytes| frame::digest(&bytes))
    }
}

/// What stands for the parameters of a build in names.
pub(crate) fn params_digest(params: &ParamsRecord) -> Result<Digest, Unreadable> {
    record::encode(params).map(|bytes| frame::digest(&bytes))
}

impl BodyNames {
    /// Those of the generation of `recipe`.
    pub(crate) fn of(params: &Digest, recipe: &RecipeRecord) -> Result<BodyNames, Unreadable> {
        let RecipeRecord { mesh, fixed_vertices, stiffness_factors, folded, .. } = recipe;
        let program = PROGRAM;
        let base = Name::Base { program, params, mesh, fixed_vertices, stiffness_factors, folded };
        let own = Name::Generation { program, params, recipe };
        Ok(BodyNames { base: base.digest()?, own: own.digest()? })
    }
}

#[derive(Serialize, Deserialize)]
struct BaseRecord {
    /// What it is kept under: a whole one in the place of another is damage, too.
    name: Digest,
    sigma_per_s2: f64,
    n_modes: u64,
    eigenvalues_per_s2: Vec<f64>,
    residuals: Vec<f64>,
    column_time: Duration,
}

#[derive(Serialize, Deserialize)]
struct BodyRecord {
    /// See [`BaseRecord::name`].
    name: Digest,
    n_rigid_modes: u64,
    eigenvalues_per_s2: Vec<f64>,
    residuals: Vec<f64>,
    error_estimates: Vec<f64>,
    angle_estimates: Vec<f64>,
    verdict: VerdictRecord,
    is_unfinished: bool,
    tolerance: Option<f64>,
    /// Of the modes, if they are not those of the base body.
    n_modes: Option<u64>,
    basis_size: u64,
    cubature: Option<FittedRecord>,
    stitch_stiffness: SmallRecord,
    gravity_loads: SmallRecord,
    /// By the name of the stage.
    timings: Vec<(String, Duration)>,
    warnings: Vec<String>,
}

#[derive(Serialize, Deserialize)]
struct SmallRecord {
    n_columns: u64,
    values: Vec<f64>,
}

#[derive(Serialize, Deserialize)]
struct FittedRecord {
    tets: Vec<u32>,
    weights: Vec<f64>,
    smoothing: Vec<Smoothing>,
    n_points: u64,
    source: SourceRecord,
    validation_error: f64,
    trained_error: f64,
}

#[derive(Serialize, Deserialize)]
enum VerdictRecord {
    Patched,
    Refined,
    Rebuilt,
}

#[derive(Serialize, Deserialize)]
enum SourceRecord {
    Trained,
    Reused,
    Refitted,
    Retrained,
}

/// A base body's bytes.
pub(crate) fn encode_base(name: &Digest, kept: &BaseSnapshot) -> Result<Vec<u8>, Unreadable> {
    let BaseSnapshot { sigma_per_s2, modes, eigenvalues_per_s2, residuals, column_time } = kept;
    let record = BaseRecord {
        name: *name,
        sigma_per_s2: *sigma_per_s2,
        n_modes: modes.n_columns as u64,
        eigenvalues_per_s2: eigenvalues_per_s2.clone(),
        residuals: residuals.clone(),
        column_time: *column_time,
    };
    framed(&record, &[modes])
}

/// A base body from its bytes.
pub(crate) fn decode_base(name: &Digest, bytes: &[u8]) -> Result<BaseSnapshot, Unreadable> {
    let (record, matrices) = unframed::<BaseRecord>(bytes)?;
    check_name(name, &record.name)?;
    let [modes] = matrices[..] else { return Err(wrong("it has another number of matrices")) };
    Ok(BaseSnapshot {
        sigma_per_s2: record.sigma_per_s2,
        modes: columns(record.n_modes, modes)?,
        eigenvalues_per_s2: record.eigenvalues_per_s2,
        residuals: record.residuals,
        column_time: record.column_time,
    })
}

/// A generation's bytes.
pub(crate) fn encode_generation(
    name: &Digest,
    kept: &GenerationSnapshot,
) -> Result<Vec<u8>, Unreadable> {
    let GenerationSnapshot {
        n_rigid_modes,
        spectrum: AuditedSpectrum { eigenvalues, residuals, error_estimates, angle_estimates },
        verdict,
        is_unfinished,
        tolerance,
        modes,
        basis,
        cubature,
        stitch_stiffness,
        gravity_loads,
        timings,
        warnings,
    } = kept;
    let record = BodyRecord {
        name: *name,
        n_rigid_modes: *n_rigid_modes as u64,
        eigenvalues_per_s2: eigenvalues.clone(),
        residuals: residuals.clone(),
        error_estimates: error_estimates.clone(),
        angle_estimates: angle_estimates.clone(),
        verdict: match verdict {
            Verdict::Patched => VerdictRecord::Patched,
            Verdict::Refined => VerdictRecord::Refined,
            Verdict::Rebuilt => VerdictRecord::Rebuilt,
        },
        is_unfinished: *is_unfinished,
        tolerance: *tolerance,
        n_modes: modes.as_ref().map(|modes| modes.n_columns as u64),
        basis_size: basis.n_columns as u64,
        cubature: cubature.as_ref().map(FittedRecord::new),
        stitch_stiffness: SmallRecord::new(stitch_stiffness),
        gravity_loads: SmallRecord::new(gravity_loads),
        timings: timings.iter().map(|(stage, took)| (stage.name().to_owned(), *took)).collect(),
        warnings: warnings.clone(),
    };
    let matrices: Vec<&Columns> = modes.iter().chain([basis]).collect();
    framed(&record, &matrices)
}

/// A generation from its bytes.
pub(crate) fn decode_generation(
    name: &Digest,
    bytes: &[u8],
) -> Result<GenerationSnapshot, Unreadable> {
    let (record, matrices) = unframed::<BodyRecord>(bytes)?;
    check_name(name, &record.name)?;
    let (modes, basis) = match (record.n_modes, &matrices[..]) {
        (Some(n_modes), [modes, basis]) => (Some(columns(n_modes, modes)?), basis),
        (None, [basis]) => (None, basis),
        _ => return Err(wrong("it has another number of matrices")),
    };
    Ok(GenerationSnapshot {
        n_rigid_modes: count(record.n_rigid_modes)?,
        spectrum: AuditedSpectrum {
            eigenvalues: record.eigenvalues_per_s2,
            residuals: record.residuals,
            error_estimates: record.error_estimates,
            angle_estimates: record.angle_estimates,
        },
        verdict: match record.verdict {
            VerdictRecord::Patched => Verdict::Patched,
            VerdictRecord::Refined => Verdict::Refined,
            VerdictRecord::Rebuilt => Verdict::Rebuilt,
        },
        is_unfinished: record.is_unfinished,
        tolerance: record.tolerance,
        modes,
        basis: columns(record.basis_size, basis)?,
        cubature: record.cubature.map(FittedRecord::snapshot).transpose()?,
        stitch_stiffness: record.stitch_stiffness.columns()?,
        gravity_loads: record.gravity_loads.columns()?,
        timings: record.timings.into_iter().map(timing).collect::<Result<_, _>>()?,
        warnings: record.warnings,
    })
}

fn wrong(why: &str) -> Unreadable {
    Unreadable::new(why)
}

fn check_name(expected: &Digest, found: &Digest) -> Result<(), Unreadable> {
    if expected == found { Ok(()) } else { Err(wrong("it is another body")) }
}

fn count(n: u64) -> Result<usize, Unreadable> {
    usize::try_from(n).map_err(Unreadable::new)
}

fn timing((name, took): (String, Duration)) -> Result<(Stage, Duration), Unreadable> {
    let stage = Stage::ALL.into_iter().find(|stage| stage.name() == name);
    Ok((stage.ok_or_else(|| wrong("there is no such stage"))?, took))
}

fn framed(record: &impl Serialize, matrices: &[&Columns]) -> Result<Vec<u8>, Unreadable> {
    let record = record::encode(record)?;
    let mut bytes = Vec::new();
    frame::add_frame(&mut bytes, &record);
    for matrix in matrices {
        let mut numbers = vec![0; size_of_val(&matrix.values[..])];
        for (to, from) in numbers.chunks_exact_mut(size_of::<f64>()).zip(&matrix.values) {
            to.copy_from_slice(&from.to_le_bytes());
        }
        frame::add_frame(&mut bytes, &numbers);
    }
    Ok(bytes)
}

/// A record, and the bytes of the matrices behind it.
fn unframed<T: DeserializeOwned>(bytes: &[u8]) -> Result<(T, Vec<&[u8]>), Unreadable> {
    let frames = frame::sequence(bytes).ok_or_else(|| wrong("a checksum is wrong"))?;
    let [record, matrices @ ..] = &frames[..] else { return Err(wrong("it is empty")) };
    Ok((record::decode(record)?, matrices.to_vec()))
}

fn columns(n_columns: u64, bytes: &[u8]) -> Result<Columns, Unreadable> {
    let (numbers, []) = bytes.as_chunks::<{ size_of::<f64>() }>() else {
        return Err(wrong("a number is cut off"));
    };
    let values: Vec<f64> = numbers.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
    Ok(Columns { n_columns: count(n_columns)?, values })
}

impl SmallRecord {
    fn new(columns: &Columns) -> SmallRecord {
        let Columns { n_columns, values } = columns;
        SmallRecord { n_columns: *n_columns as u64, values: values.clone() }
    }

    fn columns(self) -> Result<Columns, Unreadable> {
        Ok(Columns { n_columns: count(self.n_columns)?, values: self.values })
    }
}

impl FittedRecord {
    fn new(kept: &CubatureSnapshot) -> FittedRecord {
        let CubatureSnapshot { rule: Rule { tets, weights, smoothing }, report, trained_error } =
            kept;
        let CubatureReport { n_points, source, validation_error } = *report;
        FittedRecord {
            tets: tets.clone(),
            weights: weights.clone(),
            smoothing: smoothing.clone(),
            n_points: n_points as u64,
            source: match source {
                CubatureSource::Trained => SourceRecord::Trained,
                CubatureSource::Reused => SourceRecord::Reused,
                CubatureSource::Refitted => SourceRecord::Refitted,
                CubatureSource::Retrained => SourceRecord::Retrained,
            },
            validation_error,
            trained_error: *trained_error,
        }
    }

    fn snapshot(self) -> Result<CubatureSnapshot, Unreadable> {
        Ok(CubatureSnapshot {
            rule: Rule { tets: self.tets, weights: self.weights, smoothing: self.smoothing },
            report: CubatureReport {
                n_points: count(self.n_points)?,
                source: match self.source {
                    SourceRecord::Trained => CubatureSource::Trained,
                    SourceRecord::Reused => CubatureSource::Reused,
                    SourceRecord::Refitted => CubatureSource::Refitted,
                    SourceRecord::Retrained => CubatureSource::Retrained,
                },
                validation_error: self.validation_error,
            },
            trained_error: self.trained_error,
        })
    }
}
