// SPDX-License-Identifier: Apache-2.0

// probe FILE ABSENT: a callback that panics, and an error.
package main

import (
	"errors"
	"fmt"
	"os"

	"clba.example/clba"
)

func must(err error) {
	if err != nil {
		panic(err)
	}
}

func main() {
	problem, err := clba.ReadBAL(os.Args[1])
	must(err)
	defer problem.Close()
	context, err := clba.NewContext()
	must(err)
	defer context.Close()

	calls := 0
	func() {
		defer func() { fmt.Printf("%v: calls %d\n", recover(), calls) }()
		_, err := problem.Solve(context, func(row *clba.Iteration) bool {
			calls++
			if row.Iteration == 1 {
				panic("raised at iteration 1")
			}
			return true
		})
		must(err)
	}()

	var failed *clba.Error
	if _, err = clba.ReadBAL(os.Args[2]); errors.As(err, &failed) {
		fmt.Printf("status %d: %s\n", failed.Status, failed.Message)
	}
}
