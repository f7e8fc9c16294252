//! Every input of the corpora, on the stable toolchain.

use std::fs;
use std::path::Path;
use sutura_fuzz::TARGETS;

#[test]
fn every_corpus_is_taken_without_a_panic() {
    let corpora = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpora");
    for (name, target) in TARGETS {
        let mut n_inputs = 0;
        for entry in fs::read_dir(corpora.join(name)).unwrap() {
            let path = entry.unwrap().path();
            // Shown by a failing test only.
            println!("{}", path.display());
            target(&fs::read(path).unwrap());
            n_inputs += 1;
        }
        assert!(n_inputs > 0, "{name} has no corpus");
    }
    // No corpus without its target.
    assert_eq!(fs::read_dir(corpora).unwrap().count(), TARGETS.len());
}

#[test]
fn every_target_is_run_by_the_fuzzer() {
    let targets = Path::new(env!("CARGO_MANIFEST_DIR")).join("libfuzzer/targets");
    for (name, _) in TARGETS {
        let source = fs::read_to_string(targets.join(format!("{name}.rs"))).unwrap();
        assert!(source.contains(&format!("sutura_fuzz::{name}(")), "{name}");
    }
}
