//! `animimic render`: kinds of files, views, overlays.
#![allow(clippy::unwrap_used)]

#[path = "../../../crates/scene/tests/common/mod.rs"]
mod common;
mod support;

use serde_json::Value;
use support::{Bench, example, limited, text};

/// Size and pixels of a PNG.
fn pixels(path: &str) -> ((usize, usize), Vec<[u8; 3]>) {
    let mut reader =
        png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path).unwrap())).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut bytes).unwrap();
    let info = reader.info();
    ((info.width as usize, info.height as usize), bytes.as_chunks::<3>().0.to_vec())
}

/// Draws and gives what the program says.
fn drawn(arguments: &[&str]) -> Value {
    let out = limited(&[&["render"], arguments, &["--json", "-q"]].concat(), None);
    assert!(out.status.success(), "{arguments:?}: {}", text(&out.stderr));
    serde_json::from_slice(&out.stdout).unwrap()
}

#[test]
fn a_clip_becomes_an_mp4_a_gif_and_a_png_of_any_moment() {
    let bench = Bench::new();
    let model = bench.put("waving.glb", &common::creature().glb());
    for name in ["clip.mp4", "clip.gif"] {
        let out = bench.out(name);
        let said = drawn(&[&model, "-o", &out, "--height", "64", "--fps", "10", "--views", "input,+45"]);
        // One second from key to key.
        assert_eq!(said["frames"], 11, "{name}");
        let cues = limited(&["cues", &out, "-o", &bench.out("cues"), "--json", "-q"], None);
        let read: Value = serde_json::from_slice(&cues.stdout).unwrap();
        assert_eq!((read["frames"].as_u64(), read["fps"].as_f64()), (Some(11), Some(10.0)), "{name}");
    }
    let at = |secs: &str| {
        let out = bench.out("moment.png");
        assert_eq!(drawn(&[&model, "-o", &out, "--height", "64", "--views", "input", "--at", secs])["frames"], 1);
        pixels(&out).1
    };
    let (start, middle, end) = (at("0"), at("0.5"), at("1.0"));
    let changed = |a: &[[u8; 3]], b: &[[u8; 3]]| a.iter().zip(b).filter(|(p, q)| p != q).count();
    println!("{} and {} pixels change", changed(&start, &middle), changed(&middle, &end));
    assert!(changed(&start, &middle) > 100 && changed(&middle, &end) > 100);
    assert_eq!(
        std::fs::read_dir(bench.path("results")).unwrap().count(),
        4,
        "clips, a picture and cues, nothing beside them"
    );
}

#[test]
fn views_stand_side_by_side_whatever_their_shape() {
    let bench = Bench::new();
    let (model, camera) = (example("creature.glb"), example("camera.json"));
    let out = bench.out("views.png");
    let views = format!("input,-45,turntable,preset:puppeteer:back,{camera}");
    drawn(&[&model, "-o", &out, "--height", "72", "--camera", "preset:puppeteer", "--views", &views]);
    let (size, all) = pixels(&out);
    let shape: Value = serde_json::from_slice(&std::fs::read(&camera).unwrap()).unwrap();
    let own = (72.0 * shape["width"].as_f64().unwrap() / shape["height"].as_f64().unwrap()).round() as usize;
    assert_eq!(size, (4 * 72 + own, 72));
    let column = |k: usize| -> Vec<[u8; 3]> { (0..72 * 72).map(|i| all[i / 72 * size.0 + 72 * k + i % 72]).collect() };
    // Where the camera starts to go round it stands where the input view does.
    assert!(column(0) == column(2) && column(0) != column(1) && column(0) != column(3));
    let single = bench.out("single.png");
    drawn(&[&model, "-o", &single, "--height", "72", "--camera", &camera, "--views", "input"]);
    let last: Vec<[u8; 3]> = (0..72 * own).map(|i| all[i / own * size.0 + 288 + i % own]).collect();
    assert!(last == pixels(&single).1);
    drawn(&[&model, "-o", &single, "--height", "72", "--camera", "auto", "--views", "input"]);
    assert_eq!(pixels(&single).0, (72, 72));
}

#[test]
fn overlays_show_bones_weights_and_where_the_video_disagrees() {
    let bench = Bench::new();
    let (model, camera, video) = (example("creature.glb"), example("camera.json"), example("creature.mp4"));
    let out = bench.out("look.png");
    let look = |more: &[&str]| {
        drawn(&[&[&model, "-o", &out, "--height", "256", "--camera", &camera, "--views", "input"], more].concat());
        pixels(&out).1
    };
    let (plain, bones) = (look(&[]), look(&["--overlay", "skeleton"]));
    let (weights, both) = (look(&["--overlay", "weights"]), look(&["--overlay", "weights,skeleton"]));
    let background = plain[0];
    let joint = |p: &&[u8; 3]| **p == [200, 40, 40];
    let count = |picture: &[[u8; 3]]| picture.iter().filter(joint).count();
    println!("pixels of joints: {}, with weights {}", count(&bones), count(&both));
    assert!(count(&plain) == 0 && count(&bones) > 25 && count(&both) == count(&bones));
    // Weights change nothing but the surface's colours.
    assert!(plain.iter().zip(&weights).all(|(p, w)| (*p == background) == (*w == background)));
    let recolored = plain.iter().zip(&weights).filter(|(p, w)| p != w).count();
    let covered = plain.iter().filter(|p| **p != background).count();
    assert!(recolored > covered * 9 / 10, "{recolored} of {covered}");
    // The still model fits the first frame, and no longer the moving one after a second.
    let hot = |secs: &str| {
        let picture = look(&["--overlay", "residuals", "--video", &video, "--at", secs]);
        picture.iter().filter(|p| p.iter().max().unwrap() - p.iter().min().unwrap() > 60).count()
    };
    let (start, later) = (hot("0"), hot("1"));
    println!("{start} pixels disagree at first, {later} after a second");
    assert!(later > 5 * start.max(20));
}

#[test]
fn stiffness_is_drawn_as_soften_wrote_it_with_its_scale() {
    let bench = Bench::new();
    let (model, soft) = (bench.put("waving.glb", &common::creature().glb()), bench.out("soft"));
    let looks = animimic::scene::io::read(&model).unwrap().looks;
    assert!(looks.len() > 1 && looks[0].name == "skin", "flesh and a prop");
    let arguments =
        ["soften", &model, "-o", &soft, "--young", "1e6", "--young", "skin=2e3", "--tets", "200", "--height", "64"];
    let out = limited(&[&arguments[..], &["-q"]].concat(), None);
    assert!(out.status.success(), "{}", text(&out.stderr));
    let made = format!("{soft}/softened.glb");
    let mesh = animimic::scene::io::read(&made).unwrap().mesh;
    let of = |part: &str| {
        let part = mesh.parts.iter().find(|p| p.name == part).unwrap();
        mesh.youngs[part.vertices.clone()].to_vec()
    };
    println!("body {:?}, prop {:?}", of("body"), of("prop"));
    assert!(mesh.youngs.len() == mesh.positions.len());
    assert!(of("body").contains(&2e3) && of("prop").contains(&1e6));
    let picture = bench.out("look.png");
    drawn(&[&made, "-o", &picture, "--height", "400", "--views", "input", "--overlay", "stiffness"]);
    let (size, all) = pixels(&picture);
    // The scale from 1e3 to 1e6 Pa starts violet at the lower left and ends yellow.
    let bar = |x: usize| (0..size.1).map(|y| all[y * size.0 + x]).collect::<Vec<_>>();
    let (low, high) = (bar(10), bar(8 + size.0 / 3 - 3));
    assert!(low.iter().any(|p| p[0].abs_diff(68) < 9 && p[1] < 10 && p[2].abs_diff(84) < 9), "{low:?}");
    assert!(high.iter().any(|p| p[0] > 230 && p[1] > 220 && p[2] < 60), "{high:?}");
    let violet = all.iter().filter(|p| p[2] > p[1] && p[2] > p[0] && p[2].abs_diff(p[1]) > 20).count();
    println!("{violet} violet pixels");
    assert!(violet > 500);
}

#[test]
fn what_cannot_be_drawn_is_told_and_an_older_file_stays() {
    let bench = Bench::new();
    let (model, out) = (example("creature.glb"), bench.out("x.png"));
    let told = |arguments: &[&str], words: &str| {
        bench.refuses(&[&["render", &model, "-q"], arguments].concat(), &[words]);
    };
    told(&["-o", &bench.out("x.bmp")], ".mp4, .gif or .png");
    told(&["-o", &out, "--overlay", "clouds"], "weights, stiffness, residuals, skeleton");
    told(&["-o", &out, "--overlay", "residuals"], "--video FILE");
    told(&["-o", &out, "--overlay", "stiffness"], "draw the soft.glb of animate");
    told(
        &["-o", &out, "--overlay", "residuals", "--video", &example("creature.mp4"), "--views", "+45"],
        "the view input",
    );
    told(&["-o", &out, "--overlay", "residuals,weights", "--video", &example("creature.mp4")], "one of them");
    told(&["-o", &out, "--clip", "dance"], "no animation");
    told(&["-o", &out, "--views", "preset:nowhere"], "nowhere");
    told(&["-o", &out, "--video", &bench.path("no.mp4")], "no.mp4");
    let old = bench.put("old.gif", b"kept");
    let args = ["render", &model, "-q", "-o", &old, "--video", &bench.path("no.mp4")];
    assert_eq!(limited(&args, None).status.code(), Some(1));
    assert_eq!(std::fs::read(&old).unwrap(), b"kept");
}
