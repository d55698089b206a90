//! Depth as other programs write it into OpenEXR files: OpenEXR's own library 3.5 and Blender 5.0, in `data/`.
//!
//! All hold 2 + x/8 + y/4, which halves hold exactly, and no surface in the first three rows.

use animimic_scene::{DepthKind, DepthMap};
use animimic_video::cues::read_depth;
use std::path::{Path, PathBuf};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// What a folder of two such files is read as.
fn twice(name: &str, kind: Option<DepthKind>) -> Result<(Vec<DepthMap>, DepthKind), String> {
    let folder = tempfile::tempdir().expect("temporary folder");
    for number in ["9.exr", "10.exr"] {
        std::fs::copy(data(name), folder.path().join(number)).expect("copied");
    }
    read_depth(folder.path(), kind).map_err(|e| e.to_string())
}

#[test]
fn files_of_other_programs_hold_what_they_wrote() {
    for name in ["openexr_half_zip.exr", "openexr_float_rle.exr", "openexr_parts.exr", "blender_rgb.exr"] {
        let (maps, kind) = twice(name, Some(DepthKind::Inverse)).expect(name);
        assert_eq!((maps.len(), maps[1].width, maps[1].height, kind), (2, 24, 20, DepthKind::Inverse), "{name}");
        let wrong = |i: usize| {
            let (x, y, value) = (i % 24, i / 24, maps[1].values[i]);
            if y < 3 { !value.is_nan() } else { value != 2.0 + x as f32 / 8.0 + y as f32 / 4.0 }
        };
        let wrong = (0..480).filter(|&i| wrong(i)).count();
        println!("{name}: {wrong} of 480 pixels differ");
        assert_eq!(wrong, 0, "{name}");
    }
    assert_eq!(twice("openexr_half_zip.exr", None).expect("reads").1, DepthKind::Metric);
}

#[test]
fn what_is_not_read_says_how_to_convert_it() {
    let told = twice("openexr_piz.exr", None).expect_err("PIZ");
    println!("{told}");
    assert!(told.contains("10.exr") || told.contains("9.exr"));
    assert!(told.contains("compression is PIZ") && told.contains("oiiotool"));
    let folder = tempfile::tempdir().expect("temporary folder");
    std::fs::copy(data("openexr_half_zip.exr"), folder.path().join("1.exr")).expect("copied");
    std::fs::write(folder.path().join("preview.png"), b"").expect("written");
    let told = read_depth(folder.path(), None).expect_err("two kinds").to_string();
    assert!(told.contains("EXR and PNG"), "{told}");
}
