//! Input as a file, for parsers that read nothing else.

use std::path::Path;

/// Calls `work` with the path of a file of this extension that holds `data`. Each process has one file per extension.
pub fn with_file(extension: &str, data: &[u8], work: impl FnOnce(&Path)) {
    let name = format!("flyvine-fuzz-{}.{extension}", std::process::id());
    let path = std::env::temp_dir().join(name);
    std::fs::write(&path, data).expect("the temporary folder can be written");
    work(&path);
}
