use super::*;
use crate::calibration::RigModel;
use crate::needle::plane::{PlaneFit, least_squares};
use crate::needle::scene::{Hand, cloud};
use crate::needle::{EntryRequest, Settings, axis, decide};
use crate::synthetic::{Noise, rig};

fn scene(seed: u64) -> (Hand, RigModel, EntryRequest) {
    let (hand, rig) = (Hand::new(&mut Noise(seed)), rig());
    let request = hand.request(&rig);
    (hand, rig, request)
}

/// Noise-free stripes on hands of their own: what the interpolation alone costs.
#[test]
fn between_the_stripes_the_surface_is_right() {
    let (mut tilt2, mut entry2, mut axis2) = (0.0, 0.0, 0.0);
    let hands = 12;
    for seed in 0..hands {
        let (hand, rig, request) = scene(seed);
        let mut cloud = cloud(&hand.stripes(&rig), &rig, 0.0, 1, &mut Noise(1));
        // The order of the points must not matter.
        cloud.reverse();
        let d = decide(&cloud, &rig, &request, &Settings::default()).unwrap();
        let truth = PlaneFit::new(&hand.region()).unwrap().plane;
        let tilt = d
            .plane
            .normal
            .cross(&truth.normal)
            .norm()
            .asin()
            .to_degrees();
        let entry = (d.entry - hand.entry()).norm();
        let vein = axis::into_plane(&axis::line(&hand.vein()).unwrap(), &truth.normal).unwrap();
        let needle = vein * 30f64.to_radians().cos() + truth.normal * 30f64.to_radians().sin();
        let turn = needle.cross(&d.needle.axis).norm().asin().to_degrees();
        assert!(
            tilt < 0.025 && entry < 0.012 && turn < 0.03,
            "{seed}: {tilt} {entry} {turn}"
        );
        assert!(d.coverage > 0.999 && d.stripes >= 11);
        tilt2 += tilt * tilt;
        entry2 += entry * entry;
        axis2 += turn * turn;
    }
    let n = hands as f64;
    let rms = [(tilt2 / n).sqrt(), (entry2 / n).sqrt(), (axis2 / n).sqrt()];
    println!(
        "tilt {:.4}° entry {:.4} mm axis {:.4}°",
        rms[0], rms[1], rms[2]
    );
    assert!(
        rms[0] < 0.012 && rms[1] < 0.006 && rms[2] < 0.015,
        "{rms:?}"
    );
}

#[test]
fn a_hole_at_the_entry_is_refused() {
    let (hand, rig, request) = scene(3);
    let mut points = cloud(&hand.stripes(&rig), &rig, 0.0, 1, &mut Noise(1));
    points.retain(|p| (p.position - hand.entry()).norm() > 4.5);
    match decide(&points, &rig, &request, &Settings::default()) {
        Err(NeedleError::Hole { gap_mm, limit_mm }) => assert!(gap_mm > 8.0 && limit_mm < 6.0),
        other => panic!("{other:?}"),
    }
}

/// Stripes that all end at the entry: there is surface on one side of it, and nothing to follow to
/// the other.
#[test]
fn an_entry_where_the_stripes_break_off_is_refused() {
    let (hand, rig, request) = scene(3);
    let mut points = cloud(&hand.stripes(&rig), &rig, 0.0, 1, &mut Noise(1));
    points.retain(|p| p.pixel.x < request.pixel.x + 1.0);
    let said = decide(&points, &rig, &request, &Settings::default());
    assert_eq!(said, Err(NeedleError::Broken));
}

#[test]
fn an_entry_beside_the_hand_is_refused() {
    let (hand, rig, mut request) = scene(4);
    let points = cloud(&hand.stripes(&rig), &rig, 0.0, 1, &mut Noise(1));
    request.pixel += Vector2::new(150.0, 0.0); // 29 mm: the stripes end at 20 mm
    let said = decide(&points, &rig, &request, &Settings::default());
    assert!(
        matches!(
            said,
            Err(NeedleError::OffSurface { .. } | NeedleError::TooFewPoints { .. })
        ),
        "{said:?}"
    );
    // At the edge: half of the region is missing.
    request.pixel -= Vector2::new(55.0, 0.0);
    let said = decide(&points, &rig, &request, &Settings::default());
    assert!(
        matches!(said, Err(NeedleError::NotCovered { .. })),
        "{said:?}"
    );
}

/// From inside to beside the hand, and at the stripes' ends: nowhere is the surface called 0.0 mm away.
#[test]
fn an_entry_at_the_edge_is_said_to_be_there() {
    let (hand, rig, request) = scene(4);
    let points = cloud(&hand.stripes(&rig), &rig, 0.0, 1, &mut Noise(1));
    let beside = (90..125).map(|px| request.pixel + Vector2::new(f64::from(px), 0.0));
    let last = points.iter().map(|p| p.frame).max().unwrap();
    let ends = (0..=last).filter_map(|frame| {
        let stripe = points.iter().filter(|p| p.frame == frame);
        stripe.map(|p| p.pixel).max_by(|a, b| a.x.total_cmp(&b.x))
    });
    let (mut at_edge, mut off) = (0, 0);
    for pixel in beside.chain(ends) {
        let mut request = request.clone();
        request.pixel = pixel;
        match decide(&points, &rig, &request, &Settings::default()) {
            Err(NeedleError::Edge) => at_edge += 1,
            // A figure that shows why.
            Err(said @ NeedleError::OffSurface { .. }) => {
                assert!(!said.to_string().contains("is 0.0 mm away"), "{said}");
                off += 1;
            }
            Err(
                NeedleError::Broken
                | NeedleError::NotCovered { .. }
                | NeedleError::TooFewPoints { .. }
                | NeedleError::Hole { .. },
            ) => {}
            said => panic!("{pixel}: {said:?}"),
        }
    }
    assert!(at_edge > 0 && off > 0, "{at_edge} {off}");
}

#[test]
fn too_few_stripes_and_no_vein_are_refused() {
    let (hand, rig, mut request) = scene(5);
    let mut points = cloud(&hand.stripes(&rig), &rig, 0.0, 1, &mut Noise(1));
    let said = decide(&[], &rig, &request, &Settings::default());
    assert!(
        matches!(said, Err(NeedleError::TooFewPoints { points: 0, .. })),
        "{said:?}"
    );
    let vein = std::mem::take(&mut request.vein);
    let said = decide(&points, &rig, &request, &Settings::default());
    assert!(matches!(said, Err(NeedleError::NoVein { .. })), "{said:?}");
    request.vein = vein;
    points.retain(|p| p.frame % 7 == 0);
    let said = decide(&points, &rig, &request, &Settings::default());
    assert!(
        matches!(said, Err(NeedleError::TooFewPoints { .. })),
        "{said:?}"
    );
}

/// A knuckle in the region: no plane, and it says so.
#[test]
fn a_region_that_is_not_flat_is_refused() {
    let (hand, rig, request) = scene(6);
    let mut points = cloud(&hand.stripes(&rig), &rig, 0.0, 1, &mut Noise(1));
    let entry = hand.entry();
    for p in &mut points {
        let d = (p.position - entry).norm() / 6.0;
        p.position += p.position.coords.normalize() * (-6.0 * (-0.5 * d * d).exp());
    }
    let said = decide(&points, &rig, &request, &Settings::default());
    assert!(matches!(said, Err(NeedleError::NotFlat { .. })), "{said:?}");
}

/// Limits that the scene breaks by a known amount: the refusal names that amount.
#[test]
fn oblique_and_grazing_views_are_refused_with_their_angle() {
    let (hand, rig, request) = scene(8);
    let points = cloud(&hand.stripes(&rig), &rig, 0.0, 1, &mut Noise(1));
    let normal = PlaneFit::new(&hand.region()).unwrap().plane.normal;
    let mut settings = Settings::default();
    settings.limits.obliquity = 0.1;
    let sight = hand
        .entry()
        .coords
        .normalize()
        .dot(&normal)
        .acos()
        .to_degrees();
    match decide(&points, &rig, &request, &settings) {
        Err(NeedleError::Oblique {
            angle_deg,
            limit_deg,
        }) => {
            assert!((angle_deg - sight).abs() < 0.1, "{angle_deg} {sight}");
            assert!((limit_deg - 0.1f64.to_degrees()).abs() < 1e-9);
        }
        other => panic!("{other:?}"),
    }
    let mut settings = Settings::default();
    settings.limits.grazing = 1.57;
    let between = rig.light.normal.cross(&normal).norm().asin().to_degrees();
    match decide(&points, &rig, &request, &settings) {
        Err(NeedleError::Grazing { angle_deg, .. }) => {
            assert!((angle_deg - between).abs() < 1.5, "{angle_deg} {between}");
        }
        other => panic!("{other:?}"),
    }
}

/// A calibration that knows the light planes to 3 mm only: the entry is as unsure, and refused.
#[test]
fn an_uncertain_result_is_refused_with_its_figures() {
    let (hand, mut rig, request) = scene(9);
    let points = cloud(&hand.stripes(&rig), &rig, 0.0, 1, &mut Noise(1));
    rig.covariance[(12, 12)] = 9.0;
    let ray = hand.entry().coords.normalize();
    let along = 3.0 / rig.light.normal.dot(&ray).abs();
    match decide(&points, &rig, &request, &Settings::default()) {
        Err(NeedleError::TooUncertain { entry_mm, .. }) => {
            assert!((entry_mm / along - 1.0).abs() < 0.01, "{entry_mm} {along}");
        }
        other => panic!("{other:?}"),
    }
}

/// Points far off a stripe (a reflection that got through) leave the plane where it is without
/// them, to a hundredth of a degree; they tilt a bare least-squares plane by more than 2°.
#[test]
fn stray_points_do_not_tilt_the_plane() {
    for seed in 0..12 {
        let (hand, rig, request) = scene(seed);
        let clean = cloud(&hand.stripes(&rig), &rig, 0.02, 3, &mut Noise(seed));
        let frame = clean
            .iter()
            .find(|p| (p.position - hand.entry()).norm() < 6.0)
            .unwrap()
            .frame;
        let stray = |p: &CloudPoint| p.frame == frame && (p.position - hand.entry()).norm() < 9.0;
        let mut dirty = clean.clone();
        for p in dirty.iter_mut().filter(|p| stray(p)) {
            p.position += p.position.coords.normalize() * -6.0;
        }
        let mut without = clean;
        without.retain(|p| !stray(p));
        let normal = |cloud: &[CloudPoint]| {
            let decided = decide(cloud, &rig, &request, &Settings::default());
            decided.unwrap().plane.normal
        };
        let tilt = normal(&dirty).cross(&normal(&without)).norm().asin();
        let bare = |cloud: &[CloudPoint]| {
            let near = cloud
                .iter()
                .filter(|p| (p.position - hand.entry()).norm() <= request.radius_mm);
            let found = least_squares(near.map(|p| &p.position));
            found.unwrap().0.normal
        };
        let naive = bare(&dirty).cross(&bare(&without)).norm().asin();
        assert!(naive > 2f64.to_radians(), "{seed}: {naive} rad");
        assert!(tilt < 0.01f64.to_radians(), "{seed}: {tilt} of {naive} rad");
    }
}

/// A region that the hand's edge cuts: said, and what is missing counts into the uncertainty.
#[test]
fn a_region_cut_off_is_said_and_counted() {
    let (mut cut, mut beyond) = (0, 0);
    for seed in 0..40 {
        let (hand, rig, request) = scene(seed);
        let whole = cloud(&hand.stripes(&rig), &rig, 0.02, 3, &mut Noise(seed));
        let truth = PlaneFit::new(&hand.region()).unwrap().plane.normal;
        let limits = Settings::default().limits;
        let part = limits.whole.midpoint(limits.coverage);
        // The chord that leaves about that part of the disc.
        let edge = hand.entry().x + request.radius_mm * (1.0 - 1.6 * (1.0 - part).powf(0.66));
        let points: Vec<_> = whole.into_iter().filter(|p| p.position.x < edge).collect();
        let decided = decide(&points, &rig, &request, &Settings::default());
        let Ok(decided) = decided else { continue };
        assert!(decided.coverage < limits.whole, "{}", decided.coverage);
        assert!(
            decided
                .checks
                .iter()
                .any(|c| c.words.contains("was not measured"))
        );
        let off = decided.plane.normal.cross(&truth).norm();
        cut += 1;
        beyond += usize::from(off > 3.0 * decided.uncertainty.normal_sigma());
    }
    assert!(cut > 30 && beyond <= 2, "{beyond} of {cut} beyond 3 σ");
}

#[test]
fn a_vein_that_does_not_belong_to_the_entry_is_said() {
    let (hand, rig, request) = scene(2);
    let points = cloud(&hand.stripes(&rig), &rig, 0.0, 1, &mut Noise(1));
    let with = |vein: Vec<Vector2>| {
        let request = EntryRequest {
            vein,
            ..request.clone()
        };
        decide(&points, &rig, &request, &Settings::default())
    };
    let says = |vein: Vec<Vector2>, words: &str| {
        let checks = with(vein).unwrap().checks;
        checks.iter().any(|c| c.words.contains(words))
    };
    let good = &request.vein;
    assert!(!says(good.clone(), "beside the entry") && !says(good.clone(), "the vein bends"));
    let beside = good.iter().map(|p| p + Vector2::new(25.0, 0.0)).collect();
    assert!(says(beside, "beside the entry"));
    let zigzag = |k: usize| {
        Vector2::new(
            if k.is_multiple_of(2) { -25.0 } else { 25.0 },
            20.0 * k as f64,
        )
    };
    let bent = (0..4).map(|k| request.pixel + zigzag(k) - Vector2::new(0.0, 30.0));
    assert!(says(bent.collect(), "the vein bends"));
    let mut lost = good.clone();
    lost.push(request.pixel + Vector2::new(400.0, 0.0));
    assert!(says(lost, "pixels meet the measured surface") && !says(good.clone(), "pixels meet"));
    let short = vec![request.pixel, request.pixel + Vector2::new(1.0, 0.0)];
    assert!(matches!(with(short), Err(NeedleError::ShortVein { .. })));
}
