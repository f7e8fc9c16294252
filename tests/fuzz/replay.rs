//! Every input of the corpora, on the stable toolchain.

use std::fs;
use std::path::Path;
use sutura_fuzz::TARGETS;
use sutura_store::testing::{revive_body, small_body_parts};

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

/// With `SUTURA_WRITE_SEEDS` in the environment it writes them first, as after a change of their form.
#[test]
fn the_seeds_of_bodies_are_bodies() {
    for is_base in [true, false] {
        let parts = small_body_parts(is_base).unwrap();
        let mut seed = vec![u8::from(!is_base)];
        for part in &parts {
            seed.extend(u16::try_from(part.len()).unwrap().to_le_bytes());
            seed.extend(part);
        }
        let name = if is_base { "base" } else { "generation" };
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpora/body").join(name);
        if std::env::var_os("SUTURA_WRITE_SEEDS").is_some() {
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, &seed).unwrap();
        }
        let kept = fs::read(path).unwrap();
        let n_numbers = revive_body(is_base, &sutura_fuzz::parts(&kept[1..]));
        assert!(n_numbers.unwrap() > 0, "{name}: the seed is out of date");
    }
}
