// SPDX-License-Identifier: Apache-2.0
// clba.h for Node.js by koffi, as far as solve.js needs it: the declarations, and classes over them.
import koffi from 'koffi';

const VERSION = 100; // of the clba.h that these declarations were made from: 0.1.0
const OK = 0;
export const USER_STOP = 3;

koffi.opaque('clba_context');
koffi.opaque('clba_problem');
koffi.opaque('clba_result');
koffi.proto('int32_t clba_iteration_fn(const void *row, void *user_data)');

const iteration = koffi.struct('clba_iteration', {
  struct_size: 'uint32_t',
  iteration: 'int32_t',
  step_is_accepted: 'int32_t',
  step_is_valid: 'int32_t',
  linear_solver_iterations: 'int32_t',
  remaining_iterations: 'int32_t',
  num_behind: 'int64_t',
  cost: 'double',
  cost_change: 'double',
  gradient_max_norm: 'double',
  step_norm: 'double',
  gain_ratio: 'double',
  trust_region_radius: 'double',
  seconds: 'double',
  remaining_seconds: 'double',
});

const solverOptions = koffi.struct('clba_solver_options', {
  struct_size: 'uint32_t',
  linear_solver: 'int32_t',
  preconditioner: 'int32_t',
  damping: 'int32_t',
  precision: 'int32_t',
  max_num_iterations: 'int32_t',
  max_linear_solver_iterations: 'int32_t',
  min_linear_solver_iterations: 'int32_t',
  max_num_consecutive_invalid_steps: 'int32_t',
  jacobian: 'int32_t',
  initial_trust_region_radius: 'double',
  max_trust_region_radius: 'double',
  min_trust_region_radius: 'double',
  min_relative_decrease: 'double',
  min_damping_diagonal: 'double',
  max_damping_diagonal: 'double',
  function_tolerance: 'double',
  gradient_tolerance: 'double',
  parameter_tolerance: 'double',
  target_cost: 'double',
  max_seconds: 'double',
  eta: 'double',
  on_iteration: 'clba_iteration_fn *',
  user_data: 'void *',
  cancellation: 'void *',
  checkpoint_path: 'const char *',
  resume_path: 'const char *',
  checkpoint_every: 'int32_t',
  reserved: 'int32_t',
});

const summary = koffi.struct('clba_summary', {
  struct_size: 'uint32_t',
  termination: 'int32_t',
  reason: 'int32_t',
  linear_solver: 'int32_t',
  preconditioner: 'int32_t',
  damping: 'int32_t',
  precision: 'int32_t',
  num_iterations: 'int32_t',
  num_accepted_steps: 'int32_t',
  num_rejected_steps: 'int32_t',
  num_invalid_steps: 'int32_t',
  num_linear_solver_iterations: 'int32_t',
  num_behind_initial: 'int64_t',
  num_behind_final: 'int64_t',
  num_singular: 'int64_t',
  num_indefinite_blocks: 'int64_t',
  eta: 'double',
  initial_cost: 'double',
  final_cost: 'double',
  reference_final_cost: 'double',
  total_seconds: 'double',
  build_seconds: 'double',
  setup_seconds: 'double',
  linearize_seconds: 'double',
  linear_solver_seconds: 'double',
  evaluate_seconds: 'double',
  reference_seconds: 'double',
  other_seconds: 'double',
  residual_device_seconds: 'double',
  jacobian_device_seconds: 'double',
  preconditioner_device_seconds: 'double',
  jx_device_seconds: 'double',
  jty_device_seconds: 'double',
  schur_device_seconds: 'double',
  vector_device_seconds: 'double',
  peak_device_bytes: 'uint64_t',
  device: koffi.array('char', 128),
  message: koffi.array('char', 256),
  given_linear_solver: 'int32_t',
  given_preconditioner: 'int32_t',
  given_precision: 'int32_t',
  jacobian: 'int32_t',
  factorization_seconds: 'double',
  host_seconds: 'double',
  choice: koffi.array('char', 256),
  resumed_iteration: 'int32_t',
  num_checkpoints: 'int32_t',
  checkpoint_error: koffi.array('char', 256),
  gauge: 'int32_t',
  num_gauge_freedoms: 'int32_t',
  initial_prior_cost: 'double',
  final_prior_cost: 'double',
});

export const structs = {
  clba_iteration: iteration,
  clba_solver_options: solverOptions,
  clba_summary: summary,
};

const library = koffi.load('libclba.so.0');
const c = Object.fromEntries([
  'uint32_t clba_version()',
  'const char *clba_last_error()',
  'int32_t clba_context_create(const void *options, _Out_ clba_context **context)',
  'void clba_context_release(clba_context *context)',
  'int32_t clba_problem_read_bal(const char *path, _Out_ clba_problem **problem)',
  'void clba_problem_release(clba_problem *problem)',
  'int32_t clba_solver_options_init(_Out_ clba_solver_options *options, size_t struct_size)',
  'int32_t clba_problem_solve(clba_problem *problem, clba_context *context, ' +
    'const clba_solver_options *options, _Out_ clba_result **result)',
  'void clba_result_release(clba_result *result)',
  'int32_t clba_result_get_summary(const clba_result *result, _Inout_ clba_summary *summary)',
  'const char *clba_result_report(const clba_result *result)',
].map((declaration) => [/(clba_\w+)\(/.exec(declaration)[1], library.func(declaration)]));

export class ClbaError extends Error {
  constructor(status, message) {
    super(message);
    this.name = 'ClbaError';
    this.status = status;
  }
}

function check(status) {
  if (status !== OK) throw new ClbaError(status, c.clba_last_error());
}

// Before 1.0 a minor version may break the interface, so both must be those of the declarations.
export function checkVersion() {
  const loaded = c.clba_version();
  if (Math.trunc(loaded / 100) !== Math.trunc(VERSION / 100)) {
    throw new Error(`clba has version ${loaded}, but was declared for ${VERSION}`);
  }
}

// One device and the kernels built for it.
export class Context {
  constructor() {
    const made = [null];
    check(c.clba_context_create(null, made));
    this.handle = made[0];
  }

  close() {
    c.clba_context_release(this.handle);
    this.handle = null;
  }
}

export class Problem {
  constructor(handle) {
    this.handle = handle;
  }

  static readBal(path) {
    const made = [null];
    check(c.clba_problem_read_bal(path, made));
    return new Problem(made[0]);
  }

  // Calls goOn(row) after each iteration, until it is false. What it throws stops the solve and is
  // thrown from here: koffi would return 0 and go on.
  solve(context, goOn) {
    const options = {};
    check(c.clba_solver_options_init(options, koffi.sizeof(solverOptions)));
    let thrown = null;
    options.on_iteration = (row) => {
      try {
        return goOn(koffi.decode(row, iteration)) ? 0 : 1;
      } catch (error) {
        thrown = { error };
        return 1;
      }
    };
    const made = [null];
    const status = c.clba_problem_solve(this.handle, context.handle, options, made);
    if (thrown) {
      c.clba_result_release(made[0]);
      throw thrown.error;
    }
    check(status);
    return new Result(made[0]);
  }

  close() {
    c.clba_problem_release(this.handle);
    this.handle = null;
  }
}

// What a solve did.
export class Result {
  constructor(handle) {
    this.handle = handle;
  }

  summary() {
    const filled = { struct_size: koffi.sizeof(summary) };
    check(c.clba_result_get_summary(this.handle, filled));
    return filled;
  }

  report() {
    return c.clba_result_report(this.handle);
  }

  close() {
    c.clba_result_release(this.handle);
    this.handle = null;
  }
}
