//! For tests: Vulkan calls that fail when they are told to, and host memory that runs out.
//!
//! Every function of Vulkan is found by `vkGetInstanceProcAddr`, and so is the one that finds those of a device. An entry whose own
//! puts a function of the same type in the place of each that returns a `VkResult` stands between this crate, the allocator
//! included, and the loader: as a layer does, without a file. The same functions hand on allocation callbacks that count. What the
//! thread has been told counts on that thread alone, so that tests beside it see nothing of it.

use std::alloc::{self, Layout};
use std::any::TypeId;
use std::cell::{Cell, RefCell};
use std::ffi::{CStr, c_char, c_void};
use std::mem::{size_of, transmute, transmute_copy};
use std::ptr;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicIsize, AtomicPtr, Ordering};

use ash::vk::{self, Result as Code};

/// A call that fails.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Strike {
    /// Which of the calls that may fail, counted from 0.
    pub(crate) call: usize,
    /// How, as one of [`Call::results`].
    pub(crate) result: usize,
    /// Whether all later ones that may fail so do.
    pub(crate) for_good: bool,
}

/// A call that may fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Call {
    pub(crate) name: &'static str,
    /// How; what any call may return beside that, `VK_ERROR_UNKNOWN`, is the last.
    pub(crate) results: &'static [Code],
}

/// What a thread has been told, and what happened.
#[derive(Default)]
struct Told {
    strike: Option<Strike>,
    hangs: bool,
    calls: Vec<Call>,
    struck: Vec<(Call, Code)>,
    heard: Vec<String>,
}

thread_local! {
    static TOLD: RefCell<Told> = RefCell::default();
    /// Host allocations to come until one fails.
    static ALLOCATIONS_LEFT: Cell<Option<usize>> = const { Cell::new(None) };
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
    /// Whether this thread's instances are hooked.
    static HOOKED: Cell<bool> = const { Cell::new(false) };
}

/// What happened since [`begin`].
#[derive(Debug)]
pub(crate) struct Seen {
    pub(crate) calls: Vec<Call>,
    /// The calls that failed, and how.
    pub(crate) struck: Vec<(Call, Code)>,
    pub(crate) allocations: usize,
    /// Bytes of host memory taken and not given back.
    pub(crate) held: isize,
    pub(crate) messages: Vec<String>,
}

/// From now on, this thread's new instances are hooked: this call fails, or the n-th allocation, once.
pub(crate) fn begin(strike: Option<Strike>, allocation: Option<usize>) {
    HOOKED.set(true);
    ALLOCATIONS_LEFT.set(allocation);
    ALLOCATIONS.set(0);
    HELD.store(0, Ordering::Relaxed);
    TOLD.replace(Told { strike, ..Told::default() });
}

/// From now on, every wait of this thread for its hooked devices times out at once, as on a device that hangs.
pub(crate) fn hang() {
    TOLD.with_borrow_mut(|told| told.hangs = true);
}

/// Ends it, and says what happened.
pub(crate) fn end() -> Seen {
    HOOKED.set(false);
    ALLOCATIONS_LEFT.set(None);
    let Told { calls, struck, heard, .. } = TOLD.take();
    Seen { calls, struck, allocations: ALLOCATIONS.get(), held: HELD.load(Ordering::Relaxed), messages: heard }
}

/// Notes a validation message.
pub(super) fn hear(message: &str) {
    // The callback may come while the thread ends.
    let _ = TOLD.try_with(|told| told.borrow_mut().heard.push(message.to_string()));
}

/// The entry itself, or one whose calls fail as this thread is told.
pub(super) fn hooked(entry: ash::Entry) -> ash::Entry {
    if !HOOKED.get() {
        return entry;
    }
    // The library stays loaded: what is found in it is kept in statics.
    let entry = ENTRY.get_or_init(|| entry);
    keep(&GET_INSTANCE, entry.static_fn().get_instance_proc_addr as *mut c_void);
    // SAFETY: `find` hands on to the loader's function, kept above, or gives functions of the same types.
    unsafe { ash::Entry::from_static_fn(ash::StaticFn { get_instance_proc_addr: find }) }
}

/// Bytes of the host that hooked calls have taken and not given back, drivers' threads included: who tests them does so alone.
static HELD: AtomicIsize = AtomicIsize::new(0);

static ENTRY: OnceLock<ash::Entry> = OnceLock::new();
static GET_INSTANCE: AtomicPtr<c_void> = AtomicPtr::new(ptr::null_mut());
static GET_DEVICE: AtomicPtr<c_void> = AtomicPtr::new(ptr::null_mut());

fn keep(place: &AtomicPtr<c_void>, function: *mut c_void) {
    place.store(function, Ordering::Release);
}

unsafe extern "system" fn find(instance: vk::Instance, name: *const c_char) -> vk::PFN_vkVoidFunction {
    // SAFETY: `hooked` kept the loader's function there, before this could be called; the arguments are the caller's.
    let found = unsafe {
        let real: vk::PFN_vkGetInstanceProcAddr = transmute(GET_INSTANCE.load(Ordering::Acquire));
        real(instance, name)
    };
    // SAFETY: Vulkan's names end in 0.
    instead(unsafe { CStr::from_ptr(name) }, found)
}

unsafe extern "system" fn find_of_device(device: vk::Device, name: *const c_char) -> vk::PFN_vkVoidFunction {
    // SAFETY: as in `find`; `instead` kept it.
    let found = unsafe {
        let real: vk::PFN_vkGetDeviceProcAddr = transmute(GET_DEVICE.load(Ordering::Acquire));
        real(device, name)
    };
    // SAFETY: as in `find`.
    instead(unsafe { CStr::from_ptr(name) }, found)
}

/// What stands in the place of a function that was found.
fn instead(name: &CStr, found: vk::PFN_vkVoidFunction) -> vk::PFN_vkVoidFunction {
    let function = found? as *mut c_void;
    if name == c"vkGetDeviceProcAddr" {
        keep(&GET_DEVICE, function);
        // SAFETY: any function pointer may be kept as this one; it is called as what its name says.
        return Some(unsafe { transmute::<vk::PFN_vkGetDeviceProcAddr, unsafe extern "system" fn()>(find_of_device) });
    }
    let Some((index, hook)) = CALLS.iter().enumerate().find(|(_, call)| call.0.name.as_bytes() == name.to_bytes())
    else {
        return found;
    };
    keep(&REAL[index], function);
    Some(hook.1())
}

/// The functions behind the hooks. Those of one loader and one set of layers are the same for all instances.
static REAL: [AtomicPtr<c_void>; COUNT] = [const { AtomicPtr::new(ptr::null_mut()) }; COUNT];

/// How this call is to fail, if it is.
fn strikes(index: usize) -> Option<Code> {
    let call = CALLS[index].0;
    TOLD.with_borrow_mut(|told| {
        if call.results.is_empty() || !HOOKED.get() {
            return None;
        }
        told.calls.push(call);
        if told.hangs && call.name == "vkWaitSemaphores" {
            return Some(Code::TIMEOUT);
        }
        let (strike, count) = (told.strike?, told.calls.len() - 1);
        let result = match told.struck.first() {
            None if count == strike.call => call.results[strike.result],
            Some((_, result)) if strike.for_good && call.results.contains(result) => *result,
            _ => return None,
        };
        told.struck.push((call, result));
        Some(result)
    })
}

/// Counting callbacks in the place of none; other arguments as they are.
fn counted<A: Copy + 'static>(argument: A) -> A {
    if TypeId::of::<A>() != TypeId::of::<*const vk::AllocationCallbacks<'static>>() {
        return argument;
    }
    let callbacks: *const vk::AllocationCallbacks<'static> = &CALLBACKS;
    // SAFETY: the types are the same, as was just seen.
    unsafe { transmute_copy(&callbacks) }
}

/// Functions of so many arguments, of any type, that stand in the place of those which `$find` takes.
macro_rules! hooks {
    ($($module:ident: $($argument:ident)*;)*) => {$(
        mod $module {
            use super::*;

            #[expect(non_snake_case, reason = "arguments are called as their types are")]
            unsafe extern "system" fn hook<const INDEX: usize, $($argument: Copy + 'static,)* R: Outcome>(
                $($argument: $argument),*
            ) -> R {
                let struck = strikes(INDEX);
                // A device that is lost is at work on nothing: what was submitted is waited for.
                let waits = CALLS[INDEX].0.name == "vkWaitSemaphores" && struck == Some(Code::ERROR_DEVICE_LOST);
                if let Some(code) = struck && !waits {
                    return R::of(code);
                }
                // SAFETY: `instead` kept there the function of this name, whose type this is; the arguments are the caller's,
                // but for callbacks, which serve every call likewise.
                let done = unsafe {
                    let real: unsafe extern "system" fn($($argument),*) -> R = transmute(REAL[INDEX].load(Ordering::Acquire));
                    real($(counted($argument)),*)
                };
                struck.map_or(done, R::of)
            }

            /// The hook for a function of this type.
            pub(super) fn of<const INDEX: usize, $($argument: Copy + 'static,)* R: Outcome>(
                _: Number<INDEX>,
                _: Option<unsafe extern "system" fn($($argument),*) -> R>,
            ) -> unsafe extern "system" fn() {
                // SAFETY: any function pointer may be kept as this one; it is called as what its name says.
                unsafe {
                    transmute::<unsafe extern "system" fn($($argument),*) -> R, unsafe extern "system" fn()>(
                        hook::<INDEX, $($argument,)* R>,
                    )
                }
            }
        }
    )*};
}

hooks! {
    one: A;
    two: A B;
    three: A B C;
    four: A B C D;
    six: A B C D E F;
    seven: A B C D E F G;
    eight: A B C D E F G H;
}

/// What a call returns.
trait Outcome: Copy + 'static {
    fn of(code: Code) -> Self;
}

impl Outcome for Code {
    fn of(code: Code) -> Self {
        code
    }
}

impl Outcome for () {
    fn of(_: Code) {}
}

const HOST: Code = Code::ERROR_OUT_OF_HOST_MEMORY;
const DEVICE: Code = Code::ERROR_OUT_OF_DEVICE_MEMORY;
const LOST: Code = Code::ERROR_DEVICE_LOST;
const UNKNOWN: Code = Code::ERROR_UNKNOWN;

type Hook = fn() -> unsafe extern "system" fn();

/// A number that is a type.
#[derive(Clone, Copy)]
struct Number<const INDEX: usize>;

/// The table of hooks: the number of arguments, the type and so the name, and the failures that Vulkan's specification lists;
/// without any it is there for its allocation callbacks alone.
macro_rules! calls {
    ($($count:ident $pfn:ident $([$($result:expr),+])?;)*) => {
        #[expect(non_camel_case_types, reason = "called as Vulkan's functions are")]
        enum Index { $($pfn),* }

        const COUNT: usize = [$(Index::$pfn as usize),*].len();

        static CALLS: [(Call, Hook); COUNT] = [$((
            Call { name: stringify!($pfn).split_at("PFN_".len()).1, results: &[$($($result,)+ UNKNOWN)?] },
            || $count::of(Number::<{ Index::$pfn as usize }>, None::<vk::$pfn>),
        )),*];
    };
}

calls! {
    three PFN_vkEnumerateInstanceExtensionProperties [HOST, DEVICE];
    three PFN_vkCreateInstance [HOST, DEVICE, Code::ERROR_INITIALIZATION_FAILED, Code::ERROR_INCOMPATIBLE_DRIVER];
    two PFN_vkDestroyInstance;
    four PFN_vkCreateDebugUtilsMessengerEXT [HOST];
    three PFN_vkDestroyDebugUtilsMessengerEXT;
    three PFN_vkEnumeratePhysicalDevices [HOST, DEVICE, Code::ERROR_INITIALIZATION_FAILED];
    seven PFN_vkGetPhysicalDeviceImageFormatProperties [HOST, DEVICE, Code::ERROR_FORMAT_NOT_SUPPORTED];
    four PFN_vkCreateDevice [HOST, DEVICE, LOST, Code::ERROR_INITIALIZATION_FAILED, Code::ERROR_TOO_MANY_OBJECTS];
    two PFN_vkDestroyDevice;
    two PFN_vkSetDebugUtilsObjectNameEXT [HOST, DEVICE];
    four PFN_vkCreatePipelineCache [HOST, DEVICE];
    three PFN_vkDestroyPipelineCache;
    four PFN_vkGetPipelineCacheData [HOST, DEVICE, Code::INCOMPLETE];
    four PFN_vkCreateDescriptorSetLayout [HOST, DEVICE];
    three PFN_vkDestroyDescriptorSetLayout;
    four PFN_vkCreatePipelineLayout [HOST, DEVICE];
    three PFN_vkDestroyPipelineLayout;
    four PFN_vkCreateShaderModule [HOST, DEVICE];
    three PFN_vkDestroyShaderModule;
    six PFN_vkCreateComputePipelines [HOST, DEVICE, Code::ERROR_INVALID_SHADER_NV];
    three PFN_vkDestroyPipeline;
    four PFN_vkCreateBuffer [HOST, DEVICE];
    three PFN_vkDestroyBuffer;
    four PFN_vkBindBufferMemory [HOST, DEVICE];
    four PFN_vkCreateImage [HOST, DEVICE];
    three PFN_vkDestroyImage;
    four PFN_vkBindImageMemory [HOST, DEVICE];
    four PFN_vkCreateImageView [HOST, DEVICE];
    three PFN_vkDestroyImageView;
    four PFN_vkAllocateMemory [HOST, DEVICE, Code::ERROR_TOO_MANY_OBJECTS];
    three PFN_vkFreeMemory;
    six PFN_vkMapMemory [HOST, DEVICE, Code::ERROR_MEMORY_MAP_FAILED];
    four PFN_vkCreateCommandPool [HOST, DEVICE];
    three PFN_vkDestroyCommandPool;
    three PFN_vkAllocateCommandBuffers [HOST, DEVICE];
    two PFN_vkBeginCommandBuffer [HOST, DEVICE];
    one PFN_vkEndCommandBuffer [HOST, DEVICE];
    four PFN_vkCreateDescriptorPool [HOST, DEVICE, Code::ERROR_FRAGMENTATION];
    three PFN_vkDestroyDescriptorPool;
    three PFN_vkAllocateDescriptorSets [HOST, DEVICE, Code::ERROR_FRAGMENTED_POOL, Code::ERROR_OUT_OF_POOL_MEMORY];
    four PFN_vkCreateQueryPool [HOST, DEVICE];
    three PFN_vkDestroyQueryPool;
    eight PFN_vkGetQueryPoolResults [HOST, DEVICE, LOST, Code::NOT_READY];
    four PFN_vkCreateSemaphore [HOST, DEVICE];
    three PFN_vkDestroySemaphore;
    four PFN_vkQueueSubmit2 [HOST, DEVICE, LOST];
    three PFN_vkWaitSemaphores [HOST, DEVICE, LOST, Code::TIMEOUT];
    one PFN_vkDeviceWaitIdle [HOST, DEVICE, LOST];
}

/// Callbacks that count, and that give nothing when told to.
static CALLBACKS: vk::AllocationCallbacks<'static> = vk::AllocationCallbacks {
    p_user_data: ptr::null_mut(),
    pfn_allocation: Some(allocate),
    pfn_reallocation: Some(reallocate),
    pfn_free: Some(free),
    pfn_internal_allocation: None,
    pfn_internal_free: None,
    _marker: std::marker::PhantomData,
};

/// Before what is given lies how much it is and how it is aligned.
const BEFORE: usize = 2 * size_of::<usize>();

unsafe extern "system" fn allocate(
    _: *mut c_void,
    size: usize,
    alignment: usize,
    _: vk::SystemAllocationScope,
) -> *mut c_void {
    ALLOCATIONS.set(ALLOCATIONS.get() + 1);
    let left = ALLOCATIONS_LEFT.get();
    ALLOCATIONS_LEFT.set(left.and_then(|left| left.checked_sub(1)));
    let offset = BEFORE.next_multiple_of(alignment.max(1));
    let layout = Layout::from_size_align(offset + size, alignment.max(align_of::<usize>()));
    let (Ok(layout), false) = (layout, left == Some(0)) else { return ptr::null_mut() };
    // SAFETY: the layout is not empty; what is written lies before what is given, within the allocation, and is aligned, since
    // the offset is a multiple of both alignments.
    unsafe {
        let start = alloc::alloc(layout);
        if start.is_null() {
            return ptr::null_mut();
        }
        let given = start.add(offset);
        given.cast::<usize>().sub(1).write(layout.size());
        given.cast::<usize>().sub(2).write(layout.align());
        HELD.fetch_add(layout.size() as isize, Ordering::Relaxed);
        given.cast()
    }
}

/// Where an allocation begins, how large and how aligned it is.
///
/// # Safety
/// `given` came from [`allocate`].
unsafe fn layout_of(given: *mut c_void) -> (*mut u8, Layout) {
    // SAFETY: `allocate` wrote both there, of a layout that it had made.
    unsafe {
        let (size, align) = (given.cast::<usize>().sub(1).read(), given.cast::<usize>().sub(2).read());
        // What was asked for may have been less than a word's alignment, for which the offset is the same.
        (given.cast::<u8>().sub(BEFORE.next_multiple_of(align)), Layout::from_size_align_unchecked(size, align))
    }
}

unsafe extern "system" fn free(_: *mut c_void, given: *mut c_void) {
    if given.is_null() {
        return;
    }
    // SAFETY: Vulkan frees what it was given, once.
    unsafe {
        let (start, layout) = layout_of(given);
        HELD.fetch_sub(layout.size() as isize, Ordering::Relaxed);
        alloc::dealloc(start, layout);
    }
}

unsafe extern "system" fn reallocate(
    user: *mut c_void,
    original: *mut c_void,
    size: usize,
    alignment: usize,
    scope: vk::SystemAllocationScope,
) -> *mut c_void {
    if size == 0 {
        // SAFETY: as handed on.
        unsafe { free(user, original) };
        return ptr::null_mut();
    }
    // SAFETY: as handed on; what is copied is no longer than either.
    unsafe {
        let given = allocate(user, size, alignment, scope);
        if !given.is_null() && !original.is_null() {
            let (start, layout) = layout_of(original);
            let had = layout.size() - (original as usize - start as usize);
            ptr::copy_nonoverlapping(original.cast::<u8>(), given.cast::<u8>(), had.min(size));
            free(user, original);
        }
        given
    }
}
