#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| sutura_fuzz::body(bytes));
