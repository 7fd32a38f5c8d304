// SPDX-License-Identifier: Apache-2.0
import com.sun.jna.Structure;
import java.lang.reflect.Method;
import java.util.List;

/** Probe FILE ABSENT: struct layouts, a callback that throws, and an error. */
public final class Probe {
    private static void printLayout(Structure struct) throws ReflectiveOperationException {
        String name = struct.getClass().getSimpleName();
        Method offset = Structure.class.getDeclaredMethod("fieldOffset", String.class);
        offset.setAccessible(true);
        System.out.printf("size %s %d%n", name, struct.size());
        List<String> fields =
                List.of(struct.getClass().getAnnotation(Structure.FieldOrder.class).value());
        for (int i = 0; i < fields.size(); ++i) {
            int start = (int) offset.invoke(struct, fields.get(i));
            int end = i + 1 < fields.size() ? (int) offset.invoke(struct, fields.get(i + 1))
                                            : struct.size();
            System.out.printf("layout %s.%s %d %d%n", name, fields.get(i), start, end - start);
        }
    }

    public static void main(String[] arguments) throws ReflectiveOperationException {
        printLayout(new Clba.C.clba_iteration());
        printLayout(new Clba.C.clba_solver_options());
        printLayout(new Clba.C.clba_summary());

        int[] calls = {0};
        try (Clba.Problem problem = Clba.Problem.readBal(arguments[0]);
                Clba.Context context = new Clba.Context();
                Clba.Result result = problem.solve(context, row -> {
                    ++calls[0];
                    if (row.iteration == 1)
                        throw new IllegalStateException("raised at iteration 1");
                    return true;
                })) {
            System.out.println(result.report());
        } catch (IllegalStateException error) {
            System.out.printf("%s: calls %d%n", error.getMessage(), calls[0]);
        }

        try {
            Clba.Problem.readBal(arguments[1]).close();
        } catch (Clba.ClbaException error) {
            System.out.printf("status %d: %s%n", error.status, error.getMessage());
        }
    }
}
