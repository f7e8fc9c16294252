//! Edit requests and replies.

use crate::problem::Problem;
use std::collections::BTreeMap;
use std::time::Duration;
use sutura_core::build::{
    Certificate, ClosingReport, CubatureReport, CubatureSource, Derivatives, Method, Verdict,
};
use sutura_core::control::Stage;
use sutura_core::edit::Edit;
use sutura_proto::edit as wire;
use sutura_store::{EditRequest, Generation};

/// The request as the store takes it, once it could concern some body.
pub(crate) fn request(request: wire::EditRequest) -> Result<EditRequest, Problem> {
    request.validate()?;
    let edits = request.edits.into_iter().map(edit).collect();
    Ok(EditRequest {
        base_generation: request.base_generation,
        restore: request.restore,
        method: method(request.method),
        derivatives: match request.derivatives {
            wire::EditDerivatives::Own => Derivatives::Own,
            wire::EditDerivatives::Prepared => Derivatives::Prepared,
        },
        tolerance: request.tolerance,
        deadline: request.deadline_ms.map(|ms| Duration::from_secs_f64(ms / 1e3)),
        edits,
    })
}

fn edit(edit: wire::Edit) -> Edit {
    match edit {
        wire::Edit::Stitch { pairs, stiffness_n_m } => Edit::Stitch { pairs, stiffness_n_m },
        wire::Edit::Unstitch { stitch_ids } => Edit::Unstitch { stitch_ids },
        wire::Edit::UnstitchAll {} => Edit::UnstitchAll,
        wire::Edit::SetStiffness { stitch_ids, stiffness_n_m } => {
            Edit::SetStiffness { stitch_ids, stiffness_n_m }
        }
        wire::Edit::ScaleStiffness { domain, factor } => Edit::ScaleStiffness { domain, factor },
        wire::Edit::Fix { vertices } => Edit::Fix { vertices },
        wire::Edit::Release { vertices } => Edit::Release { vertices },
        wire::Edit::Close { pairs, stiffness_n_m, max_gap_m } => {
            Edit::Close { pairs, stiffness_n_m, max_gap_m }
        }
    }
}

fn method(method: wire::EditMethod) -> Method {
    match method {
        wire::EditMethod::Flexibility => Method::Flexibility,
        wire::EditMethod::LowRank => Method::LowRank,
        wire::EditMethod::FromScratch => Method::FromScratch,
    }
}

fn wire_method(method: Method) -> wire::EditMethod {
    match method {
        Method::Flexibility => wire::EditMethod::Flexibility,
        Method::LowRank => wire::EditMethod::LowRank,
        Method::FromScratch => wire::EditMethod::FromScratch,
    }
}

/// The method's name in documents and metrics.
pub(crate) fn method_name(method: Method) -> &'static str {
    match method {
        Method::Flexibility => "flexibility",
        Method::LowRank => "low_rank",
        Method::FromScratch => "from_scratch",
    }
}

/// What an edit made, `total` after the command began.
pub(crate) fn reply(generation: &Generation, method: Method, total: Duration) -> wire::EditReply {
    let artifacts = &generation.artifacts;
    wire::EditReply {
        generation: generation.number,
        method: wire_method(generation.made_by.unwrap_or(method)),
        stitch_ids: generation.stitch_ids.clone(),
        closings: artifacts.closings().iter().map(closing).collect(),
        n_stitches: artifacts.stitches().len(),
        n_rigid_modes: artifacts.n_rigid_modes(),
        eigenvalues_per_s2: artifacts.eigenvalues_per_s2().to_vec(),
        frequencies_hz: artifacts.frequencies_hz(),
        residuals: artifacts.residuals().to_vec(),
        certificate: certificate(&artifacts.certificate()),
        basis_size: artifacts.basis_size(),
        cubature: artifacts.cubature().map(cubature),
        timings_ms: timings(artifacts.timings(), total),
        warnings: artifacts.warnings().to_vec(),
    }
}

fn certificate(certificate: &Certificate) -> wire::Certificate {
    let Certificate {
        verdict,
        lower_eigenvalue_error,
        upper_eigenvalue_error,
        basis_angle,
        cubature_error,
        is_met,
        is_unfinished,
    } = *certificate;
    wire::Certificate {
        verdict: match verdict {
            Verdict::Patched => wire::Verdict::Patched,
            Verdict::Refined => wire::Verdict::Refined,
            Verdict::Rebuilt => wire::Verdict::Rebuilt,
        },
        lower_eigenvalue_error,
        upper_eigenvalue_error,
        basis_angle,
        cubature_error,
        is_met,
        is_unfinished,
    }
}

fn closing(report: &ClosingReport) -> wire::Closing {
    wire::Closing {
        edit: report.edit,
        gaps_m: report.pairs.iter().map(|pair| pair.gap_m).collect(),
        dropped_energy_j: report.dropped_energy_j,
        largest_displacement_m: report.largest_displacement_m,
        residual: report.residual(),
    }
}

fn cubature(report: &CubatureReport) -> wire::CubatureInfo {
    wire::CubatureInfo {
        n_points: report.n_points,
        source: match report.source {
            CubatureSource::Trained | CubatureSource::Retrained => wire::CubatureSource::Retrained,
            CubatureSource::Reused => wire::CubatureSource::Reused,
            CubatureSource::Refitted => wire::CubatureSource::Refitted,
        },
        validation_error: report.validation_error,
    }
}

fn timings(stages: &[(Stage, Duration)], total: Duration) -> wire::EditTimings {
    let mut timings = wire::EditTimings {
        total: milliseconds(total),
        stages: stage_milliseconds(stages),
        ..Default::default()
    };
    for (stage, took) in stages {
        let group = match stage {
            Stage::Closing => &mut timings.closing,
            Stage::Assembly | Stage::Factorization | Stage::Modes | Stage::Seams => {
                &mut timings.linear
            }
            Stage::Derivatives => &mut timings.derivatives,
            Stage::Basis | Stage::Reduction => &mut timings.reduction,
            Stage::Cubature => &mut timings.cubature,
        };
        *group += milliseconds(*took);
    }
    timings
}

/// Time spent in each stage, by its name, in ms.
pub(crate) fn stage_milliseconds(stages: &[(Stage, Duration)]) -> BTreeMap<String, f64> {
    let mut by_name = BTreeMap::new();
    for (stage, took) in stages {
        *by_name.entry(stage.name().to_owned()).or_default() += milliseconds(*took);
    }
    by_name
}

fn milliseconds(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_edit_and_method_reaches_the_store() {
        let mut wire_request = wire::EditRequest::new(vec![
            wire::Edit::Stitch { pairs: vec![[1, 2], [3, 4]], stiffness_n_m: 10.0 },
            wire::Edit::Unstitch { stitch_ids: vec![7] },
            wire::Edit::UnstitchAll {},
            wire::Edit::SetStiffness { stitch_ids: vec![8], stiffness_n_m: 20.0 },
            wire::Edit::ScaleStiffness { domain: 2, factor: 100.0 },
            wire::Edit::Fix { vertices: vec![5, 6] },
            wire::Edit::Release { vertices: vec![5] },
            wire::Edit::Close { pairs: vec![[1, 9]], stiffness_n_m: 5.0, max_gap_m: Some(1e-3) },
        ]);
        wire_request.base_generation = Some(4);
        wire_request.restore = Some(2);
        wire_request.deadline_ms = Some(50.0);
        wire_request.method = wire::EditMethod::LowRank;
        wire_request.derivatives = wire::EditDerivatives::Own;
        let converted = request(wire_request).unwrap();
        assert_eq!(
            converted,
            EditRequest {
                base_generation: Some(4),
                restore: Some(2),
                method: Method::LowRank,
                derivatives: Derivatives::Own,
                tolerance: 1e-4,
                deadline: Some(Duration::from_millis(50)),
                edits: vec![
                    Edit::Stitch { pairs: vec![[1, 2], [3, 4]], stiffness_n_m: 10.0 },
                    Edit::Unstitch { stitch_ids: vec![7] },
                    Edit::UnstitchAll,
                    Edit::SetStiffness { stitch_ids: vec![8], stiffness_n_m: 20.0 },
                    Edit::ScaleStiffness { domain: 2, factor: 100.0 },
                    Edit::Fix { vertices: vec![5, 6] },
                    Edit::Release { vertices: vec![5] },
                    Edit::Close { pairs: vec![[1, 9]], stiffness_n_m: 5.0, max_gap_m: Some(1e-3) },
                ],
            }
        );
        for wire_method_in in [
            wire::EditMethod::Flexibility,
            wire::EditMethod::LowRank,
            wire::EditMethod::FromScratch,
        ] {
            let core = method(wire_method_in);
            assert_eq!(wire_method(core), wire_method_in);
            assert_eq!(serde_json::json!(wire_method_in), method_name(core));
        }
    }

    #[test]
    fn what_no_body_accepts_is_refused_before_the_store() {
        let mut wire_request =
            wire::EditRequest::new(vec![wire::Edit::Unstitch { stitch_ids: vec![7] }]);
        wire_request.tolerance = f64::NAN;
        let problem = request(wire_request).unwrap_err();
        assert_eq!((problem.status(), problem.pointer.as_deref()), (422, Some("/tolerance")));
    }

    #[test]
    fn stages_are_grouped_and_kept_by_name() {
        let ms = Duration::from_millis;
        let stages = Stage::ALL.map(|stage| (stage, ms(1)));
        let timings = timings(&stages, ms(20));
        assert_eq!(timings.closing, 1.0);
        assert_eq!(timings.linear, 4.0);
        assert_eq!(timings.derivatives, 1.0);
        assert_eq!(timings.reduction, 2.0);
        assert_eq!(timings.cubature, 1.0);
        assert_eq!(timings.total, 20.0);
        assert_eq!(timings.stages.len(), Stage::ALL.len());
        assert_eq!(timings.stages["modes"], 1.0);
    }
}
