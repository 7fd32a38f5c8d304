// SPDX-License-Identifier: Apache-2.0
import java.math.BigDecimal;
import java.util.Locale;

/**
 * Solves a BAL file in two goes: a callback stops the first, the second runs to the end.
 *
 * <pre>
 * cmake -P fetch-jna.cmake
 * javac -cp jna.jar -d classes Clba.java Solve.java
 * java -cp jna.jar:classes Solve FILE
 * </pre>
 */
public final class Solve {
    private static void print(Clba.C.clba_iteration row) {
        System.out.printf(Locale.ROOT, "%3d  cost %.6e%n", row.iteration, row.cost);
    }

    /** 17 digits; of a double itself Java prints fewer, and zeros after them. */
    private static void print(String what, double cost) {
        System.out.printf(Locale.ROOT, "%s %.16e%n", what, new BigDecimal(cost));
    }

    public static void main(String[] arguments) {
        if (arguments.length != 1) {
            System.err.println("usage: Solve FILE");
            System.exit(1);
        }
        Clba.checkVersion();
        try (Clba.Problem problem = Clba.Problem.readBal(arguments[0]);
                Clba.Context context = new Clba.Context()) {
            try (Clba.Result stopped = problem.solve(context, row -> {
                print(row);
                return row.iteration < 3;
            })) {
                Clba.C.clba_summary halfWay = stopped.summary();
                if (halfWay.termination != Clba.C.USER_STOP)
                    throw new IllegalStateException("not stopped by the callback");
                print("stopped at", halfWay.final_cost);
            }
            // It goes on from the state that the first solve left.
            try (Clba.Result result = problem.solve(context, row -> {
                print(row);
                return true;
            })) {
                System.out.print(result.report());
                print("final cost", result.summary().final_cost);
            }
        } catch (Clba.ClbaException error) {
            System.err.println(error.getMessage());
            System.exit(1);
        }
    }
}
