//! The median of numbers that come in no order.

/// The upper of the two middle ones where there are two; 0 of none. The values are left in another
/// order.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
