//! The fuzz corpus, replayed and mutated a little on stable Rust: what fell over once does not fall over again.

use std::path::{Path, PathBuf};

use eyeline_tests::fuzz::TARGETS;
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// The corpus of one target, by name of file.
fn corpus(target: &str) -> Vec<(PathBuf, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus").join(target);
    let entries = std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files.into_iter().map(|path| (path.clone(), std::fs::read(&path).unwrap())).collect()
}

#[test]
fn nothing_in_the_corpus_makes_anything_fall_over() {
    for (target, run) in TARGETS {
        let corpus = corpus(target);
        assert!(corpus.len() >= 3, "{target}: the corpus is empty");
        for (path, bytes) in corpus {
            // Said before, since a panic names no file.
            println!("{}", path.display());
            run(&bytes);
        }
    }
}

/// A play that nobody comes to proves nothing.
#[test]
fn the_plays_of_the_corpus_go_far() {
    let mut sum = [0; 8];
    for (_, bytes) in corpus("play") {
        let stats = eyeline_tests::fuzz::play::play_to_the_end(&bytes);
        let (out, heard) = (stats.out, stats.messages_in);
        let counts = [
            stats.admitted,
            stats.resumed,
            out.states,
            out.bounds,
            out.violations,
            heard.requests(),
            stats.rejected_control,
            stats.ticks,
        ];
        for (sum, count) in sum.iter_mut().zip(counts) {
            *sum += count;
        }
    }
    println!("{sum:?}");
    assert!(sum.iter().all(|&count| count > 0), "{sum:?}");
}

/// What libFuzzer does first: flips, cuts, copies, and joins two.
fn mutate(rng: &mut Pcg64, bytes: &mut Vec<u8>, other: &[u8]) {
    for _ in 0..rng.random_range(1..=4) {
        let length = bytes.len().max(1);
        let at = rng.random_range(0..length);
        match rng.random_range(0..6) {
            0 if !bytes.is_empty() => bytes[at] ^= 1 << rng.random_range(0..8),
            1 if !bytes.is_empty() => bytes[at] = [0, 1, 0x7f, 0x80, 0xfb, 0xfc, 0xfd, 0xff][rng.random_range(0..8)],
            2 => bytes.truncate(at),
            3 if !bytes.is_empty() => {
                let end = (at + rng.random_range(1..=16)).min(bytes.len());
                let copy = bytes[at..end].to_vec();
                bytes.splice(at..at, copy);
            }
            4 if !other.is_empty() => {
                bytes.truncate(at);
                bytes.extend(&other[rng.random_range(0..other.len())..]);
            }
            _ => bytes.insert(at.min(bytes.len()), rng.next_u32() as u8),
        }
    }
    bytes.truncate(1 << 16);
}

fn mutations(rounds: u64) {
    for (target, run) in TARGETS {
        let corpus = corpus(target);
        for seed in 0..rounds {
            let mut rng = Pcg64::seed_from_u64(seed);
            let mut bytes = corpus[rng.random_range(0..corpus.len())].1.clone();
            let other = &corpus[rng.random_range(0..corpus.len())].1;
            mutate(&mut rng, &mut bytes, other);
            // Caught only to say which; it fails all the same.
            if let Err(panic) = std::panic::catch_unwind(|| run(&bytes)) {
                println!("{target}: seed {seed} falls over; its {} bytes: {}", bytes.len(), hex(&bytes));
                std::panic::resume_unwind(panic);
            }
        }
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().take(4096).map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn nor_does_what_is_nearly_in_it() {
    mutations(300);
}

#[test]
#[ignore = "minutes: what `nor_does_what_is_nearly_in_it` does, for longer"]
fn nor_do_many_mutations() {
    mutations(50_000);
}

/// Writes the corpus: a few inputs of each kind that reach far. Run with `--ignored` after a change of a format.
#[test]
#[ignore = "writes into the repository"]
fn write_the_corpus() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus");
    for (target, name, bytes) in seeds::all() {
        let folder = folder.join(target);
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join(name), bytes).unwrap();
    }
}

mod seeds;
