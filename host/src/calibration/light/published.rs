//! The paper's own Tables 1 to 4, to stand beside a rig's («Decision Method of Optimal Needle
//! Insertion Angle for Dorsal Hand Intravenous Robot», Section 2.2).

/// Table 1: Σ squared reprojection error of each board pose before and after, px².
pub const TABLE_1: [(f64, f64); 9] = [
    (56.171, 3.064e-7),
    (38.708, 3.204e-7),
    (134.205, 8.626e-7),
    (45.723, 2.098e-7),
    (41.746, 7.590e-7),
    (45.070, 2.935e-7),
    (45.809, 8.534e-7),
    (59.161, 3.765e-7),
    (43.016, 3.023e-7),
];

/// Table 2: slide position and distance from the plane 5 mm before, mm.
pub const TABLE_2: [(f64, f64); 12] = [
    (5.0, 5.21),
    (10.0, 5.13),
    (15.0, 4.98),
    (20.0, 5.00),
    (25.0, 5.21),
    (30.0, 4.97),
    (35.0, 4.83),
    (40.0, 5.08),
    (45.0, 4.84),
    (50.0, 4.91),
    (55.0, 4.98),
    (60.0, 5.03),
];

/// Table 3: A, B, C, a, b.
pub const TABLE_3: [f64; 5] = [0.007, -0.876, 0.482, -1.005, -191.717];

/// Table 4: slide position, D predicted, D real and their difference as printed, mm. (The row of
/// 10 mm prints 0.002 where the two differ by 0.059.)
pub const TABLE_4: [(f64, f64, f64, f64); 13] = [
    (0.0, -191.717, -191.428, 0.289),
    (5.0, -196.743, -196.640, 0.103),
    (10.0, -201.769, -201.710, 0.002),
    (15.0, -206.795, -206.699, 0.096),
    (20.0, -211.821, -211.701, 0.120),
    (25.0, -216.847, -217.409, 0.562),
    (30.0, -221.873, -222.175, 0.302),
    (35.0, -226.899, -227.004, 0.105),
    (40.0, -231.925, -232.084, 0.159),
    (45.0, -236.951, -236.927, 0.024),
    (50.0, -241.977, -241.839, 0.138),
    (55.0, -247.003, -246.819, 0.184),
    (60.0, -252.029, -251.849, 0.180),
];
