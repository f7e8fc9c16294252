//! A generation as what it is a function of, for the journal ([`super::record`]).

use super::frame::Digest;
use super::record::{ParamsRecord, Unreadable, size};
use crate::session::Generation;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Duration;
use sutura_core::build::{ClosedPair, ClosingReport, Derivatives, Method, Recipe, SeamRecipe};
use sutura_core::closing::Level;
use sutura_core::cubature::Rule;
use sutura_core::edit::{EditState, Stitch};
use sutura_core::mesh::TetMesh;

/// A generation, as what it is a function of ([`Recipe`]): none of its arrays, and nothing of the
/// generations before it.
#[derive(Serialize, Deserialize)]
pub(crate) struct GenerationRecord {
    pub(crate) number: u64,
    made_by: Option<MethodRecord>,
    tolerance: f64,
    improves: Option<u64>,
    stitch_ids: Vec<u64>,
    computed_in: Duration,
    pub(crate) recipe: RecipeRecord,
}

#[derive(Clone, Copy, Serialize, Deserialize)]
enum MethodRecord {
    Flexibility,
    LowRank,
    FromScratch,
    /// By flexibility, with derivatives of its own.
    OwnFlexibility,
}

impl MethodRecord {
    fn new(method: Method, derivatives: Derivatives) -> MethodRecord {
        match (method, derivatives) {
            (Method::Flexibility, Derivatives::Prepared) => MethodRecord::Flexibility,
            (Method::Flexibility, Derivatives::Own) => MethodRecord::OwnFlexibility,
            (Method::LowRank, _) => MethodRecord::LowRank,
            (Method::FromScratch, _) => MethodRecord::FromScratch,
        }
    }

    fn derivatives(self) -> Derivatives {
        match self {
            MethodRecord::OwnFlexibility => Derivatives::Own,
            _ => Derivatives::Prepared,
        }
    }

    fn method(self) -> Method {
        match self {
            MethodRecord::Flexibility | MethodRecord::OwnFlexibility => Method::Flexibility,
            MethodRecord::LowRank => Method::LowRank,
            MethodRecord::FromScratch => Method::FromScratch,
        }
    }
}

#[derive(Serialize, Deserialize)]
pub(crate) struct RecipeRecord {
    pub(crate) mesh: Digest,
    pub(super) fixed_vertices: Vec<u32>,
    pub(super) stiffness_factors: Vec<(i64, f64)>,
    stitches: Vec<StitchRecord>,
    pub(super) folded: Vec<([u32; 2], f64)>,
    next_stitch_id: u64,
    method: Option<MethodRecord>,
    tolerance: f64,
    reuse: Option<RuleRecord>,
    seam_groups: Vec<Vec<[u32; 2]>>,
    seam_closing_stiffness_n_m: f64,
    skipped: Vec<bool>,
    closings: Vec<ClosingRecord>,
}

#[derive(Serialize, Deserialize)]
struct StitchRecord {
    id: u64,
    pair: [u32; 2],
    stiffness_n_m: f64,
}

#[derive(Serialize, Deserialize)]
struct RuleRecord {
    tets: Vec<u32>,
    /// One a tet, and behind them the smoothing of each where there is any: that came later.
    weights: Vec<f64>,
    trained_error: f64,
}

#[derive(Serialize, Deserialize)]
struct ClosingRecord {
    edit: u64,
    /// The pair, its gap before and after.
    pairs: Vec<([u32; 2], f64, f64)>,
    /// Stiffness, gap, residual.
    levels: Vec<[f64; 3]>,
    dropped_energy_j: f64,
    largest_displacement_m: f64,
}

impl GenerationRecord {
    /// `mesh` is the name of the generation's.
    pub(crate) fn new(generation: &Generation, recipe: &Recipe, mesh: Digest) -> GenerationRecord {
        GenerationRecord {
            number: generation.number,
            made_by: generation
                .made_by
                .map(|method| MethodRecord::new(method, Derivatives::default())),
            tolerance: generation.tolerance,
            improves: generation.improves,
            stitch_ids: generation.stitch_ids.clone(),
            computed_in: generation.computed_in,
            recipe: RecipeRecord::new(recipe, mesh),
        }
    }

    /// The generation around what [`sutura_core::build::remake`] made of its recipe.
    pub(crate) fn generation(self, artifacts: Arc<sutura_core::build::Artifacts>) -> Generation {
        Generation {
            number: self.number,
            artifacts,
            made_by: self.made_by.map(MethodRecord::method),
            tolerance: self.tolerance,
            improves: self.improves,
            stitch_ids: self.stitch_ids,
            computed_in: self.computed_in,
        }
    }
}

impl RecipeRecord {
    pub(super) fn new(recipe: &Recipe, mesh: Digest) -> RecipeRecord {
        let Recipe { state, method, derivatives, tolerance, reuse, seams, skipped, closings } =
            recipe;
        let stitch = |stitch: &Stitch| {
            let Stitch { id, pair, stiffness_n_m } = *stitch;
            StitchRecord { id, pair, stiffness_n_m }
        };
        RecipeRecord {
            mesh,
            fixed_vertices: state.base().fixed_vertices().iter().copied().collect(),
            stiffness_factors: state
                .base()
                .stiffness_factors()
                .iter()
                .map(|(label, factor)| (*label, *factor))
                .collect(),
            stitches: state.stitches().iter().map(stitch).collect(),
            folded: state.base().folded().iter().map(|(pair, k)| (*pair, *k)).collect(),
            next_stitch_id: state.next_id(),
            method: method.map(|method| MethodRecord::new(method, *derivatives)),
            tolerance: *tolerance,
            reuse: reuse.as_ref().map(|(rule, error)| RuleRecord::new(rule, *error)),
            seam_groups: seams.groups.clone(),
            seam_closing_stiffness_n_m: seams.closing_stiffness_n_m,
            skipped: skipped.clone(),
            closings: closings.iter().map(ClosingRecord::new).collect(),
        }
    }

    /// Of a body as it is built.
    pub(super) fn of_build(mesh: Digest, params: &ParamsRecord) -> RecipeRecord {
        let mut fixed_vertices = params.fixed_vertices.clone();
        fixed_vertices.sort_unstable();
        fixed_vertices.dedup();
        RecipeRecord {
            mesh,
            fixed_vertices,
            stiffness_factors: Vec::new(),
            stitches: Vec::new(),
            folded: Vec::new(),
            next_stitch_id: 0,
            method: None,
            tolerance: 0.0,
            reuse: None,
            seam_groups: Vec::new(),
            seam_closing_stiffness_n_m: 0.0,
            skipped: Vec::new(),
            closings: Vec::new(),
        }
    }

    /// The recipe, with the mesh that it names.
    pub(crate) fn recipe(&self, mesh: Arc<TetMesh>) -> Result<Recipe, Unreadable> {
        let stitch = |stitch: &StitchRecord| {
            let StitchRecord { id, pair, stiffness_n_m } = *stitch;
            Stitch { id, pair, stiffness_n_m }
        };
        let state = EditState::from_parts(
            mesh,
            self.fixed_vertices.iter().copied().collect(),
            self.stiffness_factors.iter().copied().collect(),
            self.stitches.iter().map(stitch).collect(),
            self.folded.iter().copied().collect(),
            self.next_stitch_id,
        );
        Ok(Recipe {
            state: state.map_err(Unreadable::new)?,
            method: self.method.map(MethodRecord::method),
            derivatives: self.method.map(MethodRecord::derivatives).unwrap_or_default(),
            tolerance: self.tolerance,
            reuse: self.reuse.as_ref().map(RuleRecord::rule).transpose()?,
            seams: Arc::new(SeamRecipe {
                groups: self.seam_groups.clone(),
                closing_stiffness_n_m: self.seam_closing_stiffness_n_m,
            }),
            skipped: self.skipped.clone(),
            closings: self
                .closings
                .iter()
                .map(ClosingRecord::report)
                .collect::<Result<_, Unreadable>>()?,
        })
    }
}

impl RuleRecord {
    fn new(rule: &Rule, trained_error: f64) -> RuleRecord {
        let smoothing = rule.smoothing.as_flattened().as_flattened();
        RuleRecord {
            tets: rule.tets.clone(),
            weights: [&rule.weights, smoothing].concat(),
            trained_error,
        }
    }

    fn rule(&self) -> Result<(Rule, f64), Unreadable> {
        let RuleRecord { tets, weights, trained_error } = self;
        let (weights, numbers) = weights.split_at(tets.len().min(weights.len()));
        let (vectors, []) = numbers.as_chunks::<3>() else {
            return Err(Unreadable::new("a cubature point's smoothing is cut off"));
        };
        let (smoothing, []) = vectors.as_chunks::<4>() else {
            return Err(Unreadable::new("a cubature point's smoothing is cut off"));
        };
        let rule =
            Rule { tets: tets.clone(), weights: weights.to_vec(), smoothing: smoothing.to_vec() };
        Ok((rule, *trained_error))
    }
}

impl ClosingRecord {
    fn new(report: &ClosingReport) -> ClosingRecord {
        let ClosingReport { edit, pairs, levels, dropped_energy_j, largest_displacement_m } =
            report;
        ClosingRecord {
            edit: *edit as u64,
            pairs: pairs.iter().map(|p| (p.pair, p.gap_before_m, p.gap_m)).collect(),
            levels: levels.iter().map(|l| [l.stiffness_n_m, l.gap_m, l.residual]).collect(),
            dropped_energy_j: *dropped_energy_j,
            largest_displacement_m: *largest_displacement_m,
        }
    }

    fn report(&self) -> Result<ClosingReport, Unreadable> {
        let pair = |&(pair, gap_before_m, gap_m): &([u32; 2], f64, f64)| ClosedPair {
            pair,
            gap_before_m,
            gap_m,
        };
        let level =
            |&[stiffness_n_m, gap_m, residual]: &[f64; 3]| Level { stiffness_n_m, gap_m, residual };
        Ok(ClosingReport {
            edit: size(self.edit)?,
            pairs: self.pairs.iter().map(pair).collect(),
            levels: self.levels.iter().map(level).collect(),
            dropped_energy_j: self.dropped_energy_j,
            largest_displacement_m: self.largest_displacement_m,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_are_read_with_and_without_smoothing() {
        let record = |weights: Vec<f64>| {
            RuleRecord { tets: vec![3, 8], weights, trained_error: 0.25 }.rule()
        };
        let plain = Rule::of_tets(vec![3, 8], vec![2.0, 5.0]);
        let smoothing = vec![[[0.5, 0.0, -0.25]; 4], [[0.0, 1.0, 0.125]; 4]];
        let smoothed = Rule { smoothing, ..plain.clone() };
        for rule in [plain, smoothed] {
            let written = RuleRecord::new(&rule, 0.25);
            assert_eq!(written.rule().unwrap(), (rule, 0.25));
        }
        assert!(record(vec![2.0, 5.0, 0.5]).is_err());
        assert!(record(vec![0.0; 2 + 3]).is_err());
        // Weights are missing: the core refuses such a rule.
        assert!(record(vec![2.0]).unwrap().0.smoothing.is_empty());
    }
}
