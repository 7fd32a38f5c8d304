// SPDX-License-Identifier: Apache-2.0
//! Solves a BAL file in two goes: a callback stops the first, the second runs to the end.
//!
//!     libdir=$(pkg-config --variable=libdir clba)
//!     rustc --edition 2021 --crate-type rlib clba.rs -L native=$libdir
//!     rustc --edition 2021 solve.rs --extern clba=libclba.rlib -L native=$libdir
//!     ./solve FILE
use clba::{c, Context, Next, Problem};
use std::error::Error;

fn print(row: &c::clba_iteration) {
    println!("{:3}  cost {:.6e}", row.iteration, row.cost);
}

fn main() -> Result<(), Box<dyn Error>> {
    let file = std::env::args().nth(1).ok_or("usage: solve FILE")?;
    clba::check_version();
    let mut problem = Problem::read_bal(&file)?;
    let context = Context::new()?;

    let stopped = problem.solve(&context, |row| {
        print(row);
        if row.iteration == 3 { Next::Stop } else { Next::GoOn }
    })?;
    let half_way = stopped.summary()?;
    if half_way.termination != c::USER_STOP {
        return Err("not stopped by the callback".into());
    }
    println!("stopped at {:.16e}", half_way.final_cost);

    // It goes on from the state that the first solve left.
    let solved = problem.solve(&context, |row| {
        print(row);
        Next::GoOn
    })?;
    print!("{}", solved.report());
    println!("final cost {:.16e}", solved.summary()?.final_cost);
    Ok(())
}
