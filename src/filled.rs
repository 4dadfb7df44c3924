//! Arrays of registers.

/// `[value of 0, value of 1, …]` by a loop. The closure of [`std::array::from_fn`] is a function of its own, which the
/// optimiser may leave as a call: then it runs without the instruction set of its caller.
macro_rules! filled {
    ($k:ident in $n:ident => $value:expr) => {{
        let $k = 0;
        let mut all = [$value; $n];
        for $k in 1..$n {
            all[$k] = $value;
        }
        all
    }};
}

pub(crate) use filled;
