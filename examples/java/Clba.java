// SPDX-License-Identifier: Apache-2.0
import com.sun.jna.Callback;
import com.sun.jna.Library;
import com.sun.jna.Native;
import com.sun.jna.NativeLong;
import com.sun.jna.Pointer;
import com.sun.jna.Structure;
import com.sun.jna.ptr.PointerByReference;
import java.nio.charset.StandardCharsets;
import java.util.Map;
import java.util.function.Predicate;

/** clba.h for Java by JNA, as far as Solve needs it: the declarations in C, and classes over them. */
public final class Clba {
    /** Functions and structs under their names in clba.h; handles are pointers. */
    public interface C extends Library {
        int VERSION = 100; // of the clba.h that these declarations were made from: 0.1.0
        int OK = 0;
        int USER_STOP = 3;

        C API = Native.load("libclba.so.0", C.class,
                Map.of(Library.OPTION_STRING_ENCODING, StandardCharsets.UTF_8.name()));

        int clba_version();
        String clba_last_error();
        int clba_context_create(Pointer options, PointerByReference context);
        void clba_context_release(Pointer context);
        int clba_problem_read_bal(String path, PointerByReference problem);
        void clba_problem_release(Pointer problem);
        int clba_solver_options_init(clba_solver_options options, NativeLong structSize);
        int clba_problem_solve(Pointer problem, Pointer context, clba_solver_options options,
                PointerByReference result);
        void clba_result_release(Pointer result);
        int clba_result_get_summary(Pointer result, clba_summary summary);
        String clba_result_report(Pointer result);

        interface clba_iteration_fn extends Callback {
            int invoke(Pointer row, Pointer userData);
        }

        @Structure.FieldOrder({"struct_size", "iteration", "step_is_accepted", "step_is_valid",
            "linear_solver_iterations", "remaining_iterations", "num_behind", "cost", "cost_change",
            "gradient_max_norm", "step_norm", "gain_ratio", "trust_region_radius", "seconds",
            "remaining_seconds"})
        class clba_iteration extends Structure {
            public int struct_size;
            public int iteration;
            public int step_is_accepted;
            public int step_is_valid;
            public int linear_solver_iterations;
            public int remaining_iterations;
            public long num_behind;
            public double cost;
            public double cost_change;
            public double gradient_max_norm;
            public double step_norm;
            public double gain_ratio;
            public double trust_region_radius;
            public double seconds;
            public double remaining_seconds;

            public clba_iteration() {}

            clba_iteration(Pointer row) {
                super(row);
                read();
            }
        }

        @Structure.FieldOrder({"struct_size", "linear_solver", "preconditioner", "damping",
            "precision", "max_num_iterations", "max_linear_solver_iterations",
            "min_linear_solver_iterations", "max_num_consecutive_invalid_steps", "jacobian",
            "initial_trust_region_radius", "max_trust_region_radius", "min_trust_region_radius",
            "min_relative_decrease", "min_damping_diagonal", "max_damping_diagonal",
            "function_tolerance", "gradient_tolerance", "parameter_tolerance", "target_cost",
            "max_seconds", "eta", "on_iteration", "user_data", "cancellation", "checkpoint_path",
            "resume_path", "checkpoint_every", "reserved"})
        class clba_solver_options extends Structure {
            public int struct_size;
            public int linear_solver;
            public int preconditioner;
            public int damping;
            public int precision;
            public int max_num_iterations;
            public int max_linear_solver_iterations;
            public int min_linear_solver_iterations;
            public int max_num_consecutive_invalid_steps;
            public int jacobian;
            public double initial_trust_region_radius;
            public double max_trust_region_radius;
            public double min_trust_region_radius;
            public double min_relative_decrease;
            public double min_damping_diagonal;
            public double max_damping_diagonal;
            public double function_tolerance;
            public double gradient_tolerance;
            public double parameter_tolerance;
            public double target_cost;
            public double max_seconds;
            public double eta;
            public clba_iteration_fn on_iteration;
            public Pointer user_data;
            public Pointer cancellation;
            public String checkpoint_path;
            public String resume_path;
            public int checkpoint_every;
            public int reserved;
        }

        @Structure.FieldOrder({"struct_size", "termination", "reason", "linear_solver",
            "preconditioner", "damping", "precision", "num_iterations", "num_accepted_steps",
            "num_rejected_steps", "num_invalid_steps", "num_linear_solver_iterations",
            "num_behind_initial", "num_behind_final", "num_singular", "num_indefinite_blocks",
            "eta", "initial_cost", "final_cost", "reference_final_cost", "total_seconds",
            "build_seconds", "setup_seconds", "linearize_seconds", "linear_solver_seconds",
            "evaluate_seconds", "reference_seconds", "other_seconds", "residual_device_seconds",
            "jacobian_device_seconds", "preconditioner_device_seconds", "jx_device_seconds",
            "jty_device_seconds", "schur_device_seconds", "vector_device_seconds",
            "peak_device_bytes", "device", "message", "given_linear_solver",
            "given_preconditioner", "given_precision", "jacobian", "factorization_seconds",
            "host_seconds", "choice", "resumed_iteration", "num_checkpoints", "checkpoint_error",
            "gauge", "num_gauge_freedoms", "initial_prior_cost", "final_prior_cost"})
        class clba_summary extends Structure {
            public int struct_size;
            public int termination;
            public int reason;
            public int linear_solver;
            public int preconditioner;
            public int damping;
            public int precision;
            public int num_iterations;
            public int num_accepted_steps;
            public int num_rejected_steps;
            public int num_invalid_steps;
            public int num_linear_solver_iterations;
            public long num_behind_initial;
            public long num_behind_final;
            public long num_singular;
            public long num_indefinite_blocks;
            public double eta;
            public double initial_cost;
            public double final_cost;
            public double reference_final_cost;
            public double total_seconds;
            public double build_seconds;
            public double setup_seconds;
            public double linearize_seconds;
            public double linear_solver_seconds;
            public double evaluate_seconds;
            public double reference_seconds;
            public double other_seconds;
            public double residual_device_seconds;
            public double jacobian_device_seconds;
            public double preconditioner_device_seconds;
            public double jx_device_seconds;
            public double jty_device_seconds;
            public double schur_device_seconds;
            public double vector_device_seconds;
            public long peak_device_bytes;
            public byte[] device = new byte[128];
            public byte[] message = new byte[256];
            public int given_linear_solver;
            public int given_preconditioner;
            public int given_precision;
            public int jacobian;
            public double factorization_seconds;
            public double host_seconds;
            public byte[] choice = new byte[256];
            public int resumed_iteration;
            public int num_checkpoints;
            public byte[] checkpoint_error = new byte[256];
            public int gauge;
            public int num_gauge_freedoms;
            public double initial_prior_cost;
            public double final_prior_cost;
        }
    }

    /** A failed call. */
    public static final class ClbaException extends RuntimeException {
        private static final long serialVersionUID = 1;
        public final int status;

        ClbaException(int status, String message) {
            super(message);
            this.status = status;
        }
    }

    private static void check(int status) {
        if (status != C.OK) throw new ClbaException(status, C.API.clba_last_error());
    }

    /** Before 1.0 a minor version may break the interface: both must be those of C. */
    public static void checkVersion() {
        int loaded = C.API.clba_version();
        if (loaded / 100 != C.VERSION / 100)
            throw new UnsatisfiedLinkError(
                    "clba has version " + loaded + ", but was declared for " + C.VERSION);
    }

    /** One device and the kernels built for it. */
    public static final class Context implements AutoCloseable {
        private Pointer handle;

        /** On the best device. */
        public Context() {
            PointerByReference made = new PointerByReference();
            check(C.API.clba_context_create(null, made));
            handle = made.getValue();
        }

        @Override
        public void close() {
            C.API.clba_context_release(handle);
            handle = null;
        }
    }

    /** Used by one thread at a time. */
    public static final class Problem implements AutoCloseable {
        private Pointer handle;

        private Problem(Pointer owned) {
            handle = owned;
        }

        public static Problem readBal(String path) {
            PointerByReference made = new PointerByReference();
            check(C.API.clba_problem_read_bal(path, made));
            return new Problem(made.getValue());
        }

        /**
         * Calls goOn after each iteration, until it is false. What it throws stops the solve and is
         * thrown from here: JNA would print it and return 0.
         */
        public Result solve(Context context, Predicate<C.clba_iteration> goOn) {
            C.clba_solver_options options = new C.clba_solver_options();
            check(C.API.clba_solver_options_init(options, new NativeLong(options.size())));
            Throwable[] thrown = {null};
            options.on_iteration = (row, userData) -> {
                try {
                    return goOn.test(new C.clba_iteration(row)) ? 0 : 1;
                } catch (Throwable error) {
                    thrown[0] = error;
                    return 1;
                }
            };
            PointerByReference made = new PointerByReference();
            int status = C.API.clba_problem_solve(handle, context.handle, options, made);
            if (thrown[0] != null) {
                C.API.clba_result_release(made.getValue());
                if (thrown[0] instanceof Error) throw (Error) thrown[0];
                throw (RuntimeException) thrown[0];
            }
            check(status);
            return new Result(made.getValue());
        }

        @Override
        public void close() {
            C.API.clba_problem_release(handle);
            handle = null;
        }
    }

    /** What a solve did. */
    public static final class Result implements AutoCloseable {
        private Pointer handle;

        private Result(Pointer owned) {
            handle = owned;
        }

        public C.clba_summary summary() {
            C.clba_summary summary = new C.clba_summary();
            summary.struct_size = summary.size();
            check(C.API.clba_result_get_summary(handle, summary));
            return summary;
        }

        public String report() {
            return C.API.clba_result_report(handle);
        }

        @Override
        public void close() {
            C.API.clba_result_release(handle);
            handle = null;
        }
    }
}
