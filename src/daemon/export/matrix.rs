//! Vega's binary matrices: rows and columns as int32, then the entries as f64, column by column, all
//! little-endian. Source: VegaFEM's matrixIO library.

use super::error::ExportError;

/// The bytes before the entries.
pub(super) fn header(n_rows: usize, n_columns: usize) -> Result<[u8; 8], ExportError> {
    let number = |n: usize| {
        i32::try_from(n).map_err(|_| {
            ExportError::Unfit(format!("{n} rows or columns are more than Vega's format can say"))
        })
    };
    let [a, b] = [number(n_rows)?.to_le_bytes(), number(n_columns)?.to_le_bytes()];
    Ok([a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]])
}
