// Marks functions that use wider vectors where the processor has them. Results are the same to the bit, because
// nothing is contracted and no sum is reordered.
#pragma once

#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define ALULA_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define ALULA_WIDE
#endif
