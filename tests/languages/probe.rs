// SPDX-License-Identifier: Apache-2.0
//! probe FILE ABSENT: struct layouts, a callback that panics, and an error.
use clba::{c, Context, Next, Problem};
use std::panic::{catch_unwind, AssertUnwindSafe};

macro_rules! print_layout {
    ($($name:ident),*) => {$(
        println!("size {} {}", stringify!($name), std::mem::size_of::<c::$name>());
        for (field, offset, size) in c::$name::layout() {
            println!("layout {}.{} {} {}", stringify!($name), field, offset, size);
        }
    )*};
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    print_layout!(clba_iteration, clba_solver_options, clba_summary);

    let mut problem = Problem::read_bal(&arguments[1]).unwrap();
    let context = Context::new().unwrap();
    let mut calls = 0;
    let outcome = catch_unwind(AssertUnwindSafe(|| {
        problem.solve(&context, |row| {
            calls += 1;
            if row.iteration == 1 {
                panic!("raised at iteration 1");
            }
            Next::GoOn
        })
    }));
    let panic = outcome.err().expect("a panic");
    println!("{}: calls {}", panic.downcast_ref::<&str>().unwrap(), calls);

    let error = Problem::read_bal(&arguments[2]).err().expect("an error");
    println!("status {}: {}", error.status, error);
}
