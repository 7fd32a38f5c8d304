// SPDX-License-Identifier: Apache-2.0
//! clba.h for Rust, as far as solve.rs needs it: the declarations in `c`, and types over them that
//! are safe to use. Handles are neither Send nor Sync: a problem is used by one thread at a time.
use std::any::Any;
use std::ffi::{CStr, CString};
use std::fmt;
use std::os::raw::{c_char, c_void};
use std::panic::{catch_unwind, resume_unwind, AssertUnwindSafe};
use std::ptr;

pub mod c {
    use super::*;

    /// A struct of C, and where its fields lie: name, offset, size.
    macro_rules! c_struct {
        ($name:ident { $($field:ident: $type:ty,)* }) => {
            #[allow(non_camel_case_types)]
            #[repr(C)]
            #[derive(Clone, Copy)]
            pub struct $name { $(pub $field: $type,)* }

            impl $name {
                /// All bytes zero, which is a value of every field, but for struct_size.
                pub fn sized() -> Self {
                    let mut made: Self = unsafe { std::mem::zeroed() };
                    made.struct_size = std::mem::size_of::<Self>() as u32;
                    made
                }
                pub fn layout() -> Vec<(&'static str, usize, usize)> {
                    let made = Self::sized();
                    let start = ptr::addr_of!(made) as usize;
                    vec![$((stringify!($field), ptr::addr_of!(made.$field) as usize - start,
                            std::mem::size_of::<$type>()),)*]
                }
            }
        };
    }

    pub const VERSION: u32 = 100; // of the clba.h that these declarations were made from: 0.1.0
    pub const OK: i32 = 0;
    pub const USER_STOP: i32 = 3;

    pub type OnIteration = unsafe extern "C" fn(*const clba_iteration, *mut c_void) -> i32;

    c_struct!(clba_iteration {
        struct_size: u32,
        iteration: i32,
        step_is_accepted: i32,
        step_is_valid: i32,
        linear_solver_iterations: i32,
        remaining_iterations: i32,
        num_behind: i64,
        cost: f64,
        cost_change: f64,
        gradient_max_norm: f64,
        step_norm: f64,
        gain_ratio: f64,
        trust_region_radius: f64,
        seconds: f64,
        remaining_seconds: f64,
    });

    c_struct!(clba_solver_options {
        struct_size: u32,
        linear_solver: i32,
        preconditioner: i32,
        damping: i32,
        precision: i32,
        max_num_iterations: i32,
        max_linear_solver_iterations: i32,
        min_linear_solver_iterations: i32,
        max_num_consecutive_invalid_steps: i32,
        jacobian: i32,
        initial_trust_region_radius: f64,
        max_trust_region_radius: f64,
        min_trust_region_radius: f64,
        min_relative_decrease: f64,
        min_damping_diagonal: f64,
        max_damping_diagonal: f64,
        function_tolerance: f64,
        gradient_tolerance: f64,
        parameter_tolerance: f64,
        target_cost: f64,
        max_seconds: f64,
        eta: f64,
        on_iteration: Option<OnIteration>,
        user_data: *mut c_void,
        cancellation: *mut c_void,
        checkpoint_path: *const c_char,
        resume_path: *const c_char,
        checkpoint_every: i32,
        reserved: i32,
    });

    c_struct!(clba_summary {
        struct_size: u32,
        termination: i32,
        reason: i32,
        linear_solver: i32,
        preconditioner: i32,
        damping: i32,
        precision: i32,
        num_iterations: i32,
        num_accepted_steps: i32,
        num_rejected_steps: i32,
        num_invalid_steps: i32,
        num_linear_solver_iterations: i32,
        num_behind_initial: i64,
        num_behind_final: i64,
        num_singular: i64,
        num_indefinite_blocks: i64,
        eta: f64,
        initial_cost: f64,
        final_cost: f64,
        reference_final_cost: f64,
        total_seconds: f64,
        build_seconds: f64,
        setup_seconds: f64,
        linearize_seconds: f64,
        linear_solver_seconds: f64,
        evaluate_seconds: f64,
        reference_seconds: f64,
        other_seconds: f64,
        residual_device_seconds: f64,
        jacobian_device_seconds: f64,
        preconditioner_device_seconds: f64,
        jx_device_seconds: f64,
        jty_device_seconds: f64,
        schur_device_seconds: f64,
        vector_device_seconds: f64,
        peak_device_bytes: u64,
        device: [c_char; 128],
        message: [c_char; 256],
        given_linear_solver: i32,
        given_preconditioner: i32,
        given_precision: i32,
        jacobian: i32,
        factorization_seconds: f64,
        host_seconds: f64,
        choice: [c_char; 256],
        resumed_iteration: i32,
        num_checkpoints: i32,
        checkpoint_error: [c_char; 256],
        gauge: i32,
        num_gauge_freedoms: i32,
        initial_prior_cost: f64,
        final_prior_cost: f64,
    });

    #[link(name = "clba")]
    extern "C" {
        pub fn clba_version() -> u32;
        pub fn clba_last_error() -> *const c_char;
        pub fn clba_context_create(options: *const c_void, context: *mut *mut c_void) -> i32;
        pub fn clba_context_release(context: *mut c_void);
        pub fn clba_problem_read_bal(path: *const c_char, problem: *mut *mut c_void) -> i32;
        pub fn clba_problem_release(problem: *mut c_void);
        pub fn clba_solver_options_init(options: *mut clba_solver_options, size: usize) -> i32;
        pub fn clba_problem_solve(
            problem: *mut c_void,
            context: *mut c_void,
            options: *const clba_solver_options,
            result: *mut *mut c_void,
        ) -> i32;
        pub fn clba_result_release(result: *mut c_void);
        pub fn clba_result_get_summary(result: *const c_void, summary: *mut clba_summary) -> i32;
        pub fn clba_result_report(result: *const c_void) -> *const c_char;
    }
}

#[derive(Debug)]
pub struct Error {
    pub status: i32,
    pub message: String,
}
impl fmt::Display for Error {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.message)
    }
}
impl std::error::Error for Error {}

fn text(from: *const c_char) -> String {
    unsafe { CStr::from_ptr(from) }.to_string_lossy().into_owned()
}

fn check(status: i32) -> Result<(), Error> {
    if status == c::OK {
        return Ok(());
    }
    // A copy, as the next call on this thread overwrites the message.
    Err(Error { status, message: text(unsafe { c::clba_last_error() }) })
}

/// Before 1.0 a minor version may break the interface, so major and minor must be those of the
/// declarations above.
pub fn check_version() {
    let loaded = unsafe { c::clba_version() };
    assert!(
        loaded / 100 == c::VERSION / 100,
        "clba has version {}, but was declared for {}",
        loaded,
        c::VERSION
    );
}

pub struct Context(*mut c_void);
impl Context {
    /// On the best device.
    pub fn new() -> Result<Self, Error> {
        let mut made = ptr::null_mut();
        check(unsafe { c::clba_context_create(ptr::null(), &mut made) })?;
        Ok(Self(made))
    }
}
impl Drop for Context {
    fn drop(&mut self) {
        unsafe { c::clba_context_release(self.0) }
    }
}

pub struct Solved(*mut c_void);
impl Solved {
    pub fn summary(&self) -> Result<c::clba_summary, Error> {
        let mut summary = c::clba_summary::sized();
        check(unsafe { c::clba_result_get_summary(self.0, &mut summary) })?;
        Ok(summary)
    }
    pub fn report(&self) -> String {
        text(unsafe { c::clba_result_report(self.0) })
    }
}
impl Drop for Solved {
    fn drop(&mut self) {
        unsafe { c::clba_result_release(self.0) }
    }
}

#[derive(PartialEq)]
pub enum Next {
    GoOn,
    Stop,
}

/// What user_data points to during a solve.
struct Call<'a> {
    on_iteration: &'a mut dyn FnMut(&c::clba_iteration) -> Next,
    panic: Option<Box<dyn Any + Send>>,
}

/// A panic must not unwind into C: it is kept, and goes on when the solve has returned.
unsafe extern "C" fn enter(row: *const c::clba_iteration, user_data: *mut c_void) -> i32 {
    let call = &mut *(user_data as *mut Call);
    match catch_unwind(AssertUnwindSafe(|| (call.on_iteration)(&*row))) {
        Ok(next) => (next == Next::Stop) as i32,
        Err(panic) => {
            call.panic = Some(panic);
            1
        }
    }
}

pub struct Problem(*mut c_void);
impl Problem {
    pub fn read_bal(path: &str) -> Result<Self, Error> {
        let path = CString::new(path).expect("a path without NUL");
        let mut made = ptr::null_mut();
        check(unsafe { c::clba_problem_read_bal(path.as_ptr(), &mut made) })?;
        Ok(Self(made))
    }
    pub fn solve(
        &mut self,
        context: &Context,
        mut on_iteration: impl FnMut(&c::clba_iteration) -> Next,
    ) -> Result<Solved, Error> {
        let mut options = c::clba_solver_options::sized();
        let size = options.struct_size as usize;
        check(unsafe { c::clba_solver_options_init(&mut options, size) })?;
        let mut call = Call { on_iteration: &mut on_iteration, panic: None };
        options.on_iteration = Some(enter);
        options.user_data = &mut call as *mut Call as *mut c_void;
        let mut made = ptr::null_mut();
        let status = unsafe { c::clba_problem_solve(self.0, context.0, &options, &mut made) };
        let solved = Solved(made);
        if let Some(panic) = call.panic {
            resume_unwind(panic);
        }
        check(status)?;
        Ok(solved)
    }
}
impl Drop for Problem {
    fn drop(&mut self) {
        unsafe { c::clba_problem_release(self.0) }
    }
}
