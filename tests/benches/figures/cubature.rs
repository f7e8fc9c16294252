//! Figure 4: (a) the force error of cubature in every frame of a motion, left alone and pulled at; (b, c) the same
//! motion with and without cubature, side by side.

use super::{Course, Mover, Scene, Shot, difference, farthest, largest, over_time, reach};
use crate::bodies::Failure;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use serde_json::json;
use sutura_core::build::{Artifacts, BuildParams, Method};
use sutura_core::reduced::VertexRows;

/// Frames that a pull lasts.
const PULLED_FRAMES: usize = 25;

/// A pull, relative to the body's weight.
const PULL: f64 = 0.5;

pub(crate) fn show(scene: &Scene<'_>) -> Result<String, Failure> {
    let pairs = &scene.body.stitches;
    let made = |change: fn(BuildParams) -> BuildParams| {
        let before = scene.build(change)?;
        scene.stitch(&before, pairs, Method::Flexibility)
    };
    let with = made(|params| params)?;
    let without = made(|params| BuildParams { cubature: None, ..params })?;
    let course = scene.course(&with)?;
    let handle = handle(&with);
    let alone = run(scene, course, &with, None)?;
    let pulled = run(scene, course, &with, Some(handle))?;
    let exact = run(scene, course, &without, Some(handle))?;

    let stiffness = with.model().rest_stiffness().to_owned();
    let factor = stiffness.llt(Side::Lower).map_err(|e| format!("stiffness at rest: {e:?}"))?;
    // Relative force error in the energy norm fᵀK⁻¹f, which is about that of displacements, and in the
    // Euclidean one, which the stiffest columns rule that hardly move.
    let errors = |frames: &[Frame]| -> [Vec<f64>; 2] {
        let both: Vec<[f64; 2]> = frames
            .iter()
            .map(|frame| {
                let exact = with.evaluate_exact(&frame.q).force;
                let found = with.model().evaluate(&frame.q).force;
                let gap: Vec<f64> = found.iter().zip(&exact).map(|(a, b)| a - b).collect();
                let norms = |f: &[f64]| -> [f64; 2] {
                    let f = Mat::from_fn(f.len(), 1, |i, _| f[i]);
                    let under = factor.solve(f.as_ref());
                    let work: f64 = f.col(0).transpose() * under.col(0);
                    [work.sqrt(), f.norm_l2()]
                };
                let (gap, exact) = (norms(&gap), norms(&exact));
                [gap[0] / exact[0], gap[1] / exact[1]]
            })
            .collect();
        [0, 1].map(|norm| both.iter().map(|errors| errors[norm]).collect())
    };
    let ([error_alone, euclidean_alone], [error_pulled, euclidean_pulled]) =
        (errors(&alone), errors(&pulled));
    let percent = |errors: &[f64]| errors.iter().map(|x| 100.0 * x).collect::<Vec<f64>>();
    scene.chart(
        "a_error",
        "reduced force, error of cubature in the energy norm",
        "%",
        &[
            over_time(course, "left alone", percent(&error_alone)),
            over_time(course, "pulled at", percent(&error_pulled)),
        ],
    )?;
    let apart: Vec<f64> = pulled
        .iter()
        .zip(&exact)
        .map(|(a, b)| difference(&a.displacement, &b.displacement))
        .collect();
    let top = largest(exact.iter().map(|frame| reach(&frame.displacement)));
    scene.chart(
        "bc_difference",
        "difference of the two motions, of the largest displacement",
        "%",
        &[over_time(course, "pulled at", apart.iter().map(|x| 100.0 * x / top))],
    )?;
    let frames: Vec<Vec<f32>> = exact.iter().map(|frame| frame.displacement.clone()).collect();
    let at = farthest(&frames);
    let report = with.cubature();
    let n_points = report.map_or(0, |cubature| cubature.n_points);
    let titles = [
        format!("every one of {} tets", scene.body.mesh.tets().len()),
        format!("{n_points} cubature points"),
    ];
    scene.pictures(
        &with,
        &[
            Shot {
                name: "b_without",
                title: &titles[0],
                caption: "",
                displacement: &exact[at].displacement,
                stitches: pairs,
            },
            Shot {
                name: "c_with",
                title: &titles[1],
                caption: "",
                displacement: &pulled[at].displacement,
                stitches: pairs,
            },
        ],
    )?;
    scene.data(&json!({
        "body": scene.body.name, "n_points": n_points, "dt_s": course.dt_s,
        "held_out_error": report.map(|cubature| cubature.validation_error),
        "gravity_m_s2": course.gravity_m_s2,
        "force_error_alone": error_alone, "force_error_pulled": error_pulled,
        "euclidean_force_error_alone": euclidean_alone,
        "euclidean_force_error_pulled": euclidean_pulled,
        "difference_m": apart, "largest_displacement_m": top,
    }))?;
    let row = |name: &str, errors: &[f64]| {
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        format!(
            "| {name} | {:.2} % | {:.2} % |\n",
            100.0 * mean,
            100.0 * largest(errors.iter().copied())
        )
    };
    Ok(format!(
        "{n_points} points for {} columns.\n\n| error of the reduced force | mean | largest |\n|---|---|---|\n{}{}{}{}\
         \nMotion with cubature beside that without, pulled at: {:.2} % of the largest displacement at most (root \
         mean square over vertices), {:.2} % at the end.\n",
        with.basis_size(),
        row("left alone, energy norm", &error_alone),
        row("pulled at, energy norm", &error_pulled),
        row("left alone, Euclidean", &euclidean_alone),
        row("pulled at, Euclidean", &euclidean_pulled),
        100.0 * largest(apart.iter().copied()) / top,
        100.0 * apart.last().copied().unwrap_or(0.0) / top,
    ))
}

struct Frame {
    q: Vec<f64>,
    displacement: Vec<f32>,
}

/// The free vertex that moves most in the lowest mode.
fn handle(built: &Artifacts) -> u32 {
    let mode = built.mode(built.n_rigid_modes());
    let moved = |v: &u32| mode[3 * *v as usize..][..3].iter().map(|x| x * x).sum::<f64>();
    let free = built.full_model().free_vertices().iter().copied();
    free.max_by(|a, b| moved(a).total_cmp(&moved(b))).unwrap_or(0)
}

fn run(
    scene: &Scene<'_>,
    course: Course,
    built: &Artifacts,
    pulled_at: Option<u32>,
) -> Result<Vec<Frame>, Failure> {
    let mover = Mover::new("", built);
    let mut simulation = course.start(mover.model.clone())?;
    let rest = vec![0.0; mover.model.r()];
    let weight = -course.gravity_m_s2[1] * built.lumped_mass_kg().iter().sum::<f64>();
    let handle: Option<VertexRows> = pulled_at.map(|vertex| built.vertex_rows(vertex));
    Ok((0..scene.n_frames)
        .map(|frame| {
            // Now up, now sideways, now back.
            let direction = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0; 3]];
            let force = direction[frame / PULLED_FRAMES % 4].map(|x| PULL * weight * x);
            let loads: Vec<_> = handle.iter().map(|rows| (rows, force)).collect();
            simulation.step(&rest, &loads);
            let q = simulation.q().to_vec();
            Frame { displacement: mover.displacement(&q), q }
        })
        .collect())
}
