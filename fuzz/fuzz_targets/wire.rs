#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| eyeline_tests::fuzz::wire(bytes));
