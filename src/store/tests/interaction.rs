//! Simulations that are pulled at and that touch things.

use super::{current, displacement, next_frame, pull, ready, seam, simulation, stitch, store};
use crate::{Frame, GrabConfig, InputError, StoreError};
use sutura_core::reduced::Integrator;
use sutura_core::reduced::contact::Obstacle;

#[tokio::test]
async fn a_grab_pulls_a_vertex_to_its_target_and_a_floor_keeps_it_out() {
    let store = store();
    let id = ready(&store).await;
    let body = current(&store, id);
    let vertex = pull(1.0).vertex;
    let rest = body.artifacts.mesh().vertices()[vertex as usize];
    let mut config = simulation();
    config.params.integrator = Integrator::BackwardEuler;
    store.put_simulation(id, config.clone()).await.unwrap();
    let grab = |depth: f64| GrabConfig {
        id: 7,
        vertex,
        target_m: [rest[0], rest[1] - depth, rest[2]],
        stiffness_n_m: 100.0,
        damping_n_s_m: 1.0,
    };
    store.grab(id, vec![grab(0.01)], Vec::new()).unwrap();
    let mut frames = store.subscribe_frames(id).unwrap();
    let height = |frame: &Frame| displacement(&body, frame)[1];
    let mut until = async |what: &str, is_so: &dyn Fn(f64) -> bool| {
        for _ in 0..20_000 {
            if is_so(height(&*next_frame(&mut frames).await)) {
                return;
            }
        }
        panic!("not so yet: {what}");
    };
    until("pulled down", &|height| height <= -0.003).await;
    let info = store.simulation(id).await.unwrap();
    assert_eq!(info.n_grabs, 1);
    assert!(info.interaction_force_n[1] < 0.0);
    // A plane under the bar, into which the grab pulls it.
    let lowest = rest[1] - 0.001;
    config.obstacles =
        vec![Obstacle::Plane { point_m: [0.0, lowest, 0.0], normal: [0.0, 1.0, 0.0] }];
    config.contact.stiffness_pa_m = Some(1e8);
    store.put_simulation(id, config.clone()).await.unwrap();
    until("kept out by the plane", &|height| height >= -0.0025).await;
    // It goes on over an edit, and lets go.
    store.edit(id, stitch(&seam())).await.unwrap();
    assert_eq!(store.simulation(id).await.unwrap().n_grabs, 1);
    store.grab(id, Vec::new(), vec![7, 8]).unwrap();
    assert_eq!(store.simulation(id).await.unwrap().n_grabs, 0);
    let info = store.simulation(id).await.unwrap();
    assert!(info.error.is_none() && info.n_recovered_steps == 0);

    let refused = store.grab(id, vec![GrabConfig { vertex: u32::MAX, ..grab(0.0) }], Vec::new());
    assert!(matches!(refused, Err(StoreError::Input(InputError::GrabVertex { grab: 0, .. }))));
    let refused = store.grab(id, vec![GrabConfig { stiffness_n_m: f64::NAN, ..grab(0.0) }], vec![]);
    assert!(matches!(refused, Err(StoreError::Input(InputError::GrabStrength { grab: 0, .. }))));
    config.obstacles.push(Obstacle::Sphere { center_m: [0.0; 3], radius_m: -1.0 });
    let refused = store.put_simulation(id, config).await;
    assert!(matches!(refused, Err(StoreError::Input(InputError::Obstacle { obstacle: 1, .. }))));
}
