/* The one function of GCC's libatomic that Dr.Jit calls, for x86-64 systems without libatomic.

   cd inim/backend/libatomic
   gcc -O2 -mcx16 -nostdlib -shared -fPIC -s -fno-asynchronous-unwind-tables -fcf-protection=none \
       -Wl,-soname,libatomic.so.1 -Wl,--version-script=version.map -Wl,-z,noseparate-code \
       -Wl,-z,norelro -Wl,--build-id=none compare_exchange.c -o libatomic.so.1
*/
typedef __int128 word;

_Bool compare_exchange(word *place, word *expected, word desired, int success, int failure)
    __asm__("__atomic_compare_exchange_16");

_Bool compare_exchange(word *place, word *expected, word desired, int success, int failure) {
    (void)success; /* the instruction is sequentially consistent, whatever order is requested */
    (void)failure;
    word before = *expected, actual = __sync_val_compare_and_swap(place, before, desired);
    *expected = actual;
    return actual == before;
}
