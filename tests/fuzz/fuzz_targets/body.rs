//! The body of an HTTP request; the first byte chooses the kind. Arrays fill their shapes, and the limit holds.
#![no_main]

use bytes::Bytes;
use libfuzzer_sys::fuzz_target;
use moldline_transport::media::{Media, arrays, json};

fuzz_target!(|input: &[u8]| {
    let Some((kind, content)) = input.split_first() else { return };
    let limit = 1 << 20;
    let body = Bytes::copy_from_slice(content);
    let read = match kind % 4 {
        0 => json(&body).map(|array| vec![(String::new(), array)]),
        1 => arrays(Media::Npy, body, "design", None, limit),
        2 => arrays(Media::Npz, body, "design", None, limit),
        _ => arrays(
            Media::Octets,
            body.slice(body.len() / 2..),
            "design",
            std::str::from_utf8(&content[..content.len() / 2]).ok(),
            limit,
        ),
    };
    let Ok(read) = read else { return };
    // Plain bytes are compared with their shape later, beside that of messages.
    if kind % 4 < 3 {
        for (_, array) in &read {
            assert_eq!(array.shape.iter().product::<u64>() * 8, array.data.len() as u64);
        }
    }
    if kind % 4 == 2 {
        assert!(read.iter().map(|(_, array)| array.data.len()).sum::<usize>() <= limit);
    }
});
